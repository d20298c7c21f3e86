"""What `testloom emulator` shows: products, a unit's effects, the catalogue."""

import inspect
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from cli.emulator_values import check_effect_name
from dut_emulator.effects.catalogue import CATALOGUE, KINDS, effect_named
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import name_of
from dut_emulator.effects.parameters import conversion_to, declarations, range_for, unit_for
from dut_emulator.motion.profile import ProfileKind
from dut_emulator.motion.profile_catalogue import PROFILES
from dut_emulator.products.product import Product
from dut_emulator.twin import Twin
from protocol.language import say

_SHOWN_IN = {
    "rad/s": "deg/s",
    "m/s^2": "g",
    "T": "uT",
    "rad/sqrt(s)": "deg/sqrt(h)",
    "m/s/sqrt(s)": "m/s/sqrt(h)",
}
"""SI in files, the floor's units for people."""
_SMALLER = {"deg/s": "deg/h", "g": "mg", "1": "ppm", "rad": "arcsec"}
_SMALL = 0.01
"""A value below it is shown in the smaller unit."""


def products_table(products: list[Product]) -> Group:
    """Which product undergoes which profile, on which stand, at what rate; what the profiles are for."""
    table = Table(title=say("Products, their profiles and stands"))
    for heading in (say("Product"), say("Profile"), say("Stand")):
        table.add_column(heading, no_wrap=True)
    table.add_column(say("Rate"), justify="right", no_wrap=True)
    for product in products:
        for number, (profile, mounting) in enumerate(product.profiles.items()):
            name = product.name if number == 0 else ""
            table.add_row(name, profile, mounting.stand, f"{mounting.rate_hz:g} Hz")
        table.add_section()
    reveals = Table(title=say("Profiles"))
    reveals.add_column(say("Profile"), no_wrap=True)
    reveals.add_column(say("What it is for"), overflow="fold")
    for profile in dict.fromkeys(profile for product in products for profile in product.profiles):
        reveals.add_row(profile, Text(say(PROFILES[profile].reveals)))
    return Group(table, reveals)


def profile_table(kind: ProfileKind) -> Table:
    """A profile's parameters, for `--set`."""
    table = Table(title=Text(kind.name), caption=Text(say(kind.reveals)), caption_justify="left")
    for heading in (say("Parameter"), say("Default"), say("Unit"), say("Range"), say("What it is")):
        table.add_column(heading, no_wrap=heading != say("What it is"), overflow="fold")
    for one in kind.parameters:
        table.add_row(one.name, f"{one.default:g}", one.unit, f"{one.low:g} … {one.high:g}", say(one.meaning))
    return table


def twin_table(twin: Twin, name: str) -> Table:
    """A unit's effects: every parameter that is not at its default, in the floor's units."""
    table = Table(title=Text(name))
    table.add_column(f"{say('Effect')}, {say('Parameter')}", no_wrap=True)
    table.add_column(say("True value"), overflow="fold")
    for effect in twin.effects:
        acts_on = f" ({effect.sensor})" if effect.origin else ""
        table.add_row(Text(name_of(effect) + acts_on, style="bold"))
        for field, shown in _changed_fields(effect):
            table.add_row(f"  {field}", Text(shown))
    return table


def catalogue_table() -> Table:
    """All effects, each with what it does in a line."""
    table = Table(title=say("Effects"))
    for heading in (say("Effect"), say("Stage")):
        table.add_column(heading, no_wrap=True)
    table.add_column(say("What it is"), overflow="fold")
    for kind in KINDS:
        names = dict.fromkeys(name_of(kind(sensor)) for sensor in kind.sensors)
        first_line = inspect.cleandoc(kind.__doc__ or "").splitlines()[0]
        table.add_row("\n".join(names), kind.stage.name.lower(), Text(first_line))
    return table


def effect_page(name: str) -> Group:
    """One effect in full.

    Raises:
        TestloomError: there is none of this name.
    """
    check_effect_name(name)
    sensors = CATALOGUE[name][1]
    effect = effect_named(name, sensors[0])
    table = Table()
    for heading in (say("Parameter"), say("Unit"), say("Range"), say("What it is")):
        table.add_column(heading, no_wrap=heading != say("What it is"), overflow="fold")
    for field, declaration in declarations(effect).items():
        low, high = range_for(declaration, effect.sensor)
        named = f"{field}_1_x …" if declaration.powers else f"{field}{_axes(getattr(effect, field))}"
        unit = unit_for(declaration.unit, effect.sensor)
        table.add_row(named, unit, f"{low:g} … {high:g}", Text(declaration.meaning))
    stage = effect.stage.name.lower()
    about = say("Acts on {sensors}, stage {stage}.", sensors=", ".join(sensors), stage=stage)
    valid = [Text(effect.valid)] if effect.valid else []
    words = Text(inspect.cleandoc(type(effect).__doc__ or ""))
    return Group(Text(name, style="bold"), Text(about), words, *valid, table)


def _axes(default: Any) -> str:
    return ("", "_x _y _z", "_xx … _zz")[np.ndim(default)]


def _changed_fields(effect: CatalogueEffect) -> list[tuple[str, str]]:
    neutral = type(effect)(effect.sensor)
    rows: list[tuple[str, str]] = []
    for field, declaration in declarations(effect).items():
        value = getattr(effect, field)
        if value != getattr(neutral, field):
            rows.append((field, _shown(value, unit_for(declaration.unit, effect.sensor))))
    if getattr(effect, "axis", None) != getattr(neutral, "axis", None):
        rows.append(("axis", str(getattr(effect, "axis", ""))))
    return rows


def _shown(value: Any, unit: str) -> str:
    """Numbers and unit as the floor says them; a matrix row by row."""
    values = np.asarray(value, dtype=np.float64)
    shown_unit = " per ".join(_SHOWN_IN.get(part, part) for part in unit.split(" per "))
    factor = conversion_to(unit, shown_unit)
    smaller = _SMALLER.get(shown_unit)
    if smaller is not None and np.abs(values).max(initial=0.0) * factor < _SMALL:
        shown_unit, factor = smaller, conversion_to(unit, smaller)
    rows = np.atleast_2d(values * factor)
    lines = [", ".join(f"{number:.5g}" for number in row) for row in rows]
    unit_below = "\n" if " per " in shown_unit else " "  # a line may not break inside the unit
    return "\n".join(lines) + ("" if shown_unit == "1" else unit_below + shown_unit)
