"""`name=value[unit]` on the command line: profile parameters, and parameters of effects."""

import difflib
import json
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from dut_emulator.effects.catalogue import CATALOGUE, effect_named
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName
from dut_emulator.effects.parameters import conversion_to, declarations, scalars, unit_for
from dut_emulator.motion.profile import ProfileKind
from dut_emulator.twin import Twin, parse_twin, twin_text
from protocol.errors import Fault, TestloomError
from protocol.units_of_measure import KNOWN_UNITS, is_known_unit, quantity_of

_QUANTITY = re.compile(r"\s*(\w+)\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_AROUND_SLASH = re.compile(r"\s*/\s*")
COMMAND_LINE = "command line"


def parsed(given: Sequence[str]) -> dict[str, tuple[float, str]]:
    """Name → value and unit, "" where none is given.

    Raises:
        TestloomError: not of this form, or a name twice.
    """
    found: dict[str, tuple[float, str]] = {}
    for text in given:
        match = _QUANTITY.fullmatch(text)
        if match is None:
            raise _refused(f"'{text}' is no value.", "write name=value or name=value and its unit.")
        name, value, unit = match.groups()
        if not math.isfinite(float(value)):
            raise _refused(f"'{text}' is no value.", "give a number that is not infinite.")
        if name in found:
            raise _refused(f"{name} is given twice.", "give it once.")
        found[name] = (float(value), _AROUND_SLASH.sub("/", unit))
    return found


def profile_values(kind: ProfileKind, given: Sequence[str]) -> dict[str, float]:
    """What `--set` says, in the units of the profile's parameters; names are checked by the profile."""
    units = {parameter.name: parameter.unit for parameter in kind.parameters}
    return {
        name: value * (_factor(name, unit, units[name]) if unit and name in units else 1.0)
        for name, (value, unit) in parsed(given).items()
    }


def with_effect(
    twin: Twin, name: str, sensor: SensorName | None, axis: str | None, given: Sequence[str]
) -> Twin:
    """The twin with this effect: its own with other parameters if it has it, else a new one.

    A value without a unit is in the parameter's SI unit.

    Raises:
        TestloomError: an unknown effect or parameter, a wrong unit, a value out of range, a clash.
    """
    if sensor is None and name in CATALOGUE and len(CATALOGUE[name][1]) == 1:
        sensor = CATALOGUE[name][1][0]
    check_effect_name(name)
    with _the_operators_words():
        neutral = effect_named(name, sensor)
    entries = json.loads(twin_text(twin))["effects"]
    entry = next(
        (one for one in entries if (one["effect"], one["sensor"]) == (name, sensor)),
        {"effect": name, "sensor": sensor, "parameters": {}},
    )
    if not given:
        names = ", ".join(scalar.name for scalar in scalars(neutral))
        raise _refused(f"'{name}' without parameters changes nothing.", f"give some of: {names}.")
    for parameter, (value, unit) in parsed(given).items():
        spelled = _spelled(unit, _declared_unit(neutral, parameter))
        entry["parameters"][parameter] = {"value": value, "unit": spelled}
    if axis is not None:
        entry["axis"] = axis
    document = {"format": "testloom-twin/1", "product": twin.product, "effects": [entry]}
    with _the_operators_words():
        (effect,) = parse_twin(json.dumps(document), COMMAND_LINE).effects
        return twin.with_effect(effect)


def check_effect_name(name: str) -> None:
    """Raises TestloomError for a name that the catalogue does not have; says which are like it."""
    if name in CATALOGUE:
        return
    like = [known for known in CATALOGUE if name and name.lower() in known]
    like = like or difflib.get_close_matches(name, CATALOGUE, n=5)
    listed = "'testloom emulator effects' lists them all."
    raise _refused(
        f"There is no effect '{name}'.", f"use one of: {', '.join(like)}; {listed}" if like else listed
    )


@contextmanager
def _the_operators_words() -> Iterator[None]:
    """What is refused within came from the command line, and is in no file that could be corrected."""
    try:
        yield
    except TestloomError as error:
        place = error.where.removeprefix(f"{COMMAND_LINE}, effects[0] ")
        where = f"{COMMAND_LINE}, {place}" if place != error.where else COMMAND_LINE
        raise TestloomError(error.what, where=where, fault=Fault.OPERATOR, remedy=error.remedy) from error


def _factor(name: str, unit: str, declared: str) -> float:
    if unit == declared:  # a profile may have a unit that nothing else has: degC/min
        return 1.0
    try:
        return conversion_to(unit, declared)
    except TestloomError as error:
        like = [known for known in KNOWN_UNITS if _measures(declared) == _measures(known)] or [declared]
        remedy = f"give the value in one of: {', '.join(like)}."
        raise TestloomError(
            error.what, where=f"{COMMAND_LINE}, {name}", fault=Fault.OPERATOR, remedy=remedy
        ) from error


def _measures(unit: str) -> str:
    return quantity_of(unit) if is_known_unit(unit) else ""


def _spelled(unit: str, declared: str) -> str:
    """The unit as the catalogue spells it: 'deg/s/g' is 'deg/s per g' there; the declared one if none."""
    if not unit:
        return declared
    if " per " in declared and " per " not in unit and "/" in unit:
        compound = " per ".join(unit.rsplit("/", 1))
        try:
            conversion_to(compound, declared)
        except TestloomError:
            return unit  # to be refused as it was written
        return compound
    return unit


def _declared_unit(effect: CatalogueEffect, parameter: str) -> str:
    """Of the field that this scalar is a part of; "" if there is none, which is refused later."""
    fields = [
        field for field in declarations(effect) if parameter == field or parameter.startswith(f"{field}_")
    ]
    return unit_for(declarations(effect)[max(fields, key=len)].unit, effect.sensor) if fields else ""


def _refused(what: str, remedy: str) -> TestloomError:
    return TestloomError(what, where=COMMAND_LINE, fault=Fault.OPERATOR, remedy=remedy)
