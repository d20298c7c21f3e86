"""The twin file: which effects a simulated unit has, with their parameters and units. JSON, versioned.

    {"format": "testloom-twin/1", "product": "gnc_module",
     "effects": [{"effect": "gyro.g_sensitivity",
                  "parameters": {"acc_xy": {"value": 0.004, "unit": "deg/s per g"}}},
                 {"effect": "stand.wobble", "sensor": "acc", "axis": "inner",
                  "parameters": {"cosine_rad_x": {"value": 5, "unit": "arcsec"}}}]}

Parameters are the scalars of `dut_emulator.effects.parameters`, as a gap report names them; what is absent
is at its default. Units are converted, never guessed: 'deg/s per g' goes for 'rad/s per m/s^2'.
Effects do not commute: each triad's stand in the order of their stages, so that the file reads as it acts.
"""

import dataclasses
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, ValidationError

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectChain, SensorName, Stage, name_of
from dut_emulator.effects.parameters import (
    ZERO,
    check_ranges,
    conversion_to,
    declarations,
    scalars,
    with_values,
)
from protocol.durable_files import write_whole
from protocol.errors import Fault, TestloomError
from protocol.frozen_model import FrozenModel

TWIN_FORMAT: Literal["testloom-twin/1"] = "testloom-twin/1"
MAX_TWIN_BYTES = 1_000_000
MAX_POWERS = 9
"""Highest power of a polynomial over temperature."""
_CUTS_BEFORE = {"quantization": "saturation"}
"""Of one stage, and only right in one order: a cut comes before the rounding."""


class _Quantity(FrozenModel):
    value: float
    unit: str


class _Entry(FrozenModel):
    effect: str
    sensor: str | None = None
    stage: str | None = None
    axis: str | None = None
    parameters: dict[str, _Quantity] = Field(default_factory=dict[str, _Quantity])


class _Document(FrozenModel):
    format: str
    product: str = ""
    effects: list[_Entry]


@dataclass(frozen=True)
class Twin:
    """A simulated unit's effects, in the order in which they act.

    Raises:
        TestloomError: an effect twice, two that describe the same thing, or stages out of order.
    """

    product: str = ""
    effects: tuple[CatalogueEffect, ...] = ()

    def __post_init__(self) -> None:
        _refuse_clashes(self.effects, "twin")

    def with_effect(self, effect: CatalogueEffect) -> "Twin":
        """One effect more, after the others of its stage, or this one in place of that of the same name."""
        same = [other for other in self.effects if _key(other) == _key(effect)]
        if same:
            kept = tuple(effect if other is same[0] else other for other in self.effects)
        else:
            kept = tuple(sorted((*self.effects, effect), key=lambda one: (one.sensor, one.stage, _rank(one))))
        return dataclasses.replace(self, effects=kept)

    def chain(self, sensor: SensorName) -> EffectChain:
        """The effects of one triad."""
        return EffectChain(effect for effect in self.effects if effect.sensor == sensor)


def read_twin(path: Path) -> Twin:
    """The twin in a file.

    Raises:
        TestloomError: no file, no JSON, another format, an unknown effect, a wrong unit, a parameter outside
            its range, effects that clash; says where.
    """
    if not path.is_file():
        raise _refused("There is no such twin file.", str(path), "give the name of a twin file.")
    if path.stat().st_size > MAX_TWIN_BYTES:
        raise _refused(f"The file is larger than {MAX_TWIN_BYTES} bytes.", str(path), "is it a twin file?")
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors put a mark first
    except UnicodeDecodeError as error:
        raise _refused("The file is not UTF-8 text.", str(path), "is it a twin file?") from error
    except OSError as error:
        raise _refused(
            f"The file cannot be read: {error.strerror}.", str(path), "may you read it?"
        ) from error
    return parse_twin(text, str(path))


def parse_twin(text: str, where: str = "twin") -> Twin:
    """The twin in a text; `where` goes into errors. Raises as `read_twin`."""
    try:
        document = _Document.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the text"
        raise _refused(f"{first['msg']}.", f"{where}, {place}", "correct the file at this place.") from error
    if document.format != TWIN_FORMAT:
        remedy = f"this version reads {TWIN_FORMAT}."
        raise _refused(f"The format is '{document.format}'.", f"{where}, format", remedy)
    effects = tuple(
        _effect_from(entry, f"{where}, effects[{index}] {entry.effect}")
        for index, entry in enumerate(document.effects)
    )
    _refuse_clashes(effects, where)
    return Twin(document.product, effects)


def twin_text(twin: Twin) -> str:
    """The twin as JSON in SI units; defaults are left out. `parse_twin` gives the same twin back."""
    document = _Document(
        format=TWIN_FORMAT, product=twin.product, effects=[_entry_for(effect) for effect in twin.effects]
    )
    return document.model_dump_json(indent=2, exclude_none=True) + "\n"


def write_twin(twin: Twin, path: Path) -> None:
    """Write a twin file, whole or not at all.

    Raises:
        RecordingError: the disk refuses.
    """
    write_whole(path, twin_text(twin))


def _entry_for(effect: CatalogueEffect) -> _Entry:
    neutral = effect_named(name_of(effect), effect.sensor)
    defaults = {scalar.name: scalar.value for scalar in scalars(neutral)}
    parameters = {
        scalar.name: _Quantity(value=scalar.value, unit=scalar.unit)
        for scalar in scalars(effect)
        if scalar.value != defaults.get(scalar.name)
    }
    return _Entry(
        effect=name_of(effect),
        sensor=effect.sensor,
        stage=effect.stage.name.lower(),
        axis=getattr(effect, "axis", None),
        parameters=parameters,
    )


def _effect_from(entry: _Entry, where: str) -> CatalogueEffect:
    if entry.sensor is not None and entry.sensor not in get_args(SensorName):
        remedy = f"use one of: {', '.join(get_args(SensorName))}."
        raise _refused(f"There is no sensor '{entry.sensor}'.", where, remedy)
    sensor: Any = entry.sensor
    try:
        effect = effect_named(entry.effect, sensor)
    except TestloomError as error:
        raise _refused(error.what, where, error.remedy) from error
    if entry.stage is not None and entry.stage != effect.stage.name.lower():
        text = f"'{entry.effect}' acts at the stage '{effect.stage.name.lower()}', not at '{entry.stage}'."
        raise _refused(text, where, "leave the stage out, or choose another effect.")
    effect = _with_rows(_with_axis(effect, entry.axis, where), entry.parameters, where)
    known = {scalar.name: scalar for scalar in scalars(effect)}
    values: dict[str, float] = {}
    for name, quantity in entry.parameters.items():
        if name not in known:
            remedy = f"use some of: {', '.join(known)}."
            raise _refused(f"'{entry.effect}' has no parameter '{name}'.", where, remedy)
        try:
            factor = conversion_to(quantity.unit, known[name].unit)
        except TestloomError as error:
            remedy = f"give it in {known[name].unit}, or in another unit of the same quantity."
            raise _refused(error.what, f"{where}, {name}", remedy) from error
        values[name] = quantity.value * factor
    effect = with_values(effect, values)
    check_ranges(effect, where)
    return effect


def _with_axis(effect: CatalogueEffect, axis: str | None, where: str) -> CatalogueEffect:
    if axis is None:
        return effect
    if not hasattr(effect, "axis") or axis not in ("outer", "middle", "inner"):
        text = f"'{name_of(effect)}' has no axis '{axis}'."
        raise _refused(text, where, "outer, middle or inner, for stand effects that follow an angle.")
    changes: dict[str, Any] = {"axis": axis}
    return dataclasses.replace(effect, **changes)


def _with_rows(effect: CatalogueEffect, parameters: Iterable[str], where: str) -> CatalogueEffect:
    """With as many powers in its polynomial as the parameters' names ask for."""
    for field, declaration in declarations(effect).items():
        if not declaration.powers:
            continue
        named = re.compile(rf"{field}_(\d{{1,3}})_[xyz]")
        powers = [int(match[1]) for name in parameters if (match := named.fullmatch(name))]
        if max(powers, default=0) > MAX_POWERS or min(powers, default=1) < 1:
            raise _refused(f"{field} has powers 1 to {MAX_POWERS}.", where, "leave other powers out.")
        changes: dict[str, Any] = {field: (ZERO,) * max(powers, default=0)}
        effect = dataclasses.replace(effect, **changes)
    return effect


def _key(effect: CatalogueEffect) -> tuple[SensorName, str]:
    return effect.sensor, name_of(effect)


def _rank(effect: CatalogueEffect) -> int:
    return int(effect.word in _CUTS_BEFORE)


def _refuse_clashes(effects: tuple[CatalogueEffect, ...], where: str) -> None:
    for index, effect in enumerate(effects):
        for earlier in effects[:index]:
            if earlier.sensor == effect.sensor:
                _refuse_pair(earlier, effect, where)


def _refuse_pair(earlier: CatalogueEffect, effect: CatalogueEffect, where: str) -> None:
    one, other = name_of(earlier), name_of(effect)
    if one == other:
        raise _refused(f"'{other}' is there twice for {effect.sensor}.", where, "keep one of them.")
    if earlier.word in effect.excludes or effect.word in earlier.excludes:
        text = f"'{one}' and '{other}' describe the same thing in two ways."
        raise _refused(text, where, "keep one of them.")
    if earlier.stage > effect.stage or _CUTS_BEFORE.get(earlier.word) == effect.word:
        order = ", ".join(stage.name.lower() for stage in Stage)
        text = (
            f"'{one}' ({earlier.stage.name.lower()}) stands before '{other}' ({effect.stage.name.lower()}), "
            "but acts after it."
        )
        raise _refused(text, where, f"list a triad's effects by stage: {order}; quantization last.")


def _refused(what: str, where: str, remedy: str) -> TestloomError:
    return TestloomError(what, where=where, fault=Fault.DATA, remedy=remedy)
