# pyright: strict
"""From a report to a twin file that has the effects found.

What is in a report is measured against the belief of the recordings (matrix, bias, noise, bandwidth), not
against a twin file. So for an effect that a belief cannot hold, the report's figure is the whole of it: it
replaces what the twin says. A bandwidth is one beside the believed lag: the two time constants add. Of an
effect that the twin has, parameters that the report does not state stay. A parameter that is smaller than its
own standard uncertainty is left out: the test did not see it, and with it the simulator would be worse.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dut_emulator.effects.catalogue import CATALOGUE, effect_named
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName, name_of
from dut_emulator.effects.parameters import AXES, declarations, scalars, unit_for
from dut_emulator.twin import TWIN_FORMAT, Twin, parse_twin, twin_text
from gap_diagnosis.field_units import spelled_like
from gap_diagnosis.report_document import NAMES_A_SET, Attribution, HeldValue, ReportDocument, refused
from protocol.errors import Fault, TestloomError

ADDS_TO_BELIEVED = frozenset({"bandwidth"})
"""Words of effects of which the belief has a part that its prediction has passed already."""
_SAME = 1e-6

_WITHOUT_A_SET = {
    "no_gap": ("The report found no gap: there is nothing to add.", "use the twin as it is."),
    "unattributed": (
        "The report found a gap that no set of effects explains.",
        "look at what it describes, record its next test, and diagnose again with that.",
    ),
}

How = Literal["new", "replaced", "added", "shape", "left out"]


@dataclass(frozen=True)
class ParameterChange:
    """One parameter of the twin, in SI. `before`: None if the twin did not have the effect."""

    effect: str
    sensor: SensorName
    parameter: str
    before: float | None
    after: float
    unit: str
    how: How


@dataclass(frozen=True)
class FoundEffect:
    """An effect as a report has it.

    Attributes:
        effect: with the parameters that are known, the others neutral.
        stated: their names.
        left_out: names of those that are smaller than their uncertainty.
    """

    effect: CatalogueEffect
    stated: tuple[str, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class TwinChange:
    """The twin with the effects, and what of it is another."""

    twin: Twin
    changes: tuple[ParameterChange, ...]


def twin_with_found(twin: Twin, report: ReportDocument, where: str, rank: int = 1) -> TwinChange:
    """The twin with the effects of a report's set.

    Args:
        twin: what the simulator has now.
        report: see the module.
        where: the report's file, for errors.
        rank: which of the report's sets; 1 is the most probable one.

    Raises:
        TestloomError: no such set, another product's twin, an effect or parameter that is unknown, wrong in
            its unit or range, or that clashes with what the twin has.
    """
    if report.product and twin.product and report.product != twin.product:
        raise refused(
            f"The report is about a {report.product}, the twin is one of a {twin.product}.",
            where,
            "give a twin of this product.",
        )
    changes: list[ParameterChange] = []
    for found in found_effects(report, where, rank):
        own = next((one for one in twin.effects if _key(one) == _key(found.effect)), None)
        merged = found.effect if own is None else _merged(own, found, where)
        changes += _changes(own, merged, found)
        twin = twin.with_effect(merged)
    return TwinChange(twin, tuple(changes))


def found_effects(report: ReportDocument, where: str, rank: int = 1) -> list[FoundEffect]:
    """The effects of a report's set with their parameters.

    Raises:
        TestloomError: no such set, an effect or parameter that is unknown, wrong in its unit or range.
    """
    sets = [one for one in report.sets if one.effects]
    if report.verdict not in NAMES_A_SET:
        what, remedy = _WITHOUT_A_SET[report.verdict]
        raise refused(what, f"{where}, verdict", remedy)
    if not 1 <= rank <= len(sets):
        text = f"The report has {len(sets)} sets of effects, and no set number {rank}."
        raise TestloomError(
            text, where=f"{where}, sets", fault=Fault.OPERATOR, remedy="1 is the most probable."
        )
    return [found_effect(entry, where) for entry in report.entries_of(sets[rank - 1].effects)]


def found_effect(entry: Attribution, where: str) -> FoundEffect:
    """One entry of `which`; raises as `found_effects`."""
    place = f"{where}, which {entry.effect}"
    sensor = _sensor(entry, place)
    neutral = effect_named(entry.effect, sensor)
    written: dict[str, HeldValue] = {}
    left_out: list[str] = []
    for name, value in entry.parameters.items():
        for scalar in _scalar_names(neutral, name, entry.channels):
            if abs(value.value) < (value.standard_uncertainty or 0.0):
                left_out.append(scalar)
            else:
                written[scalar] = value
    if not written:
        raise refused("The report states no parameter of this effect.", place, "diagnose again.")
    written |= entry.held
    document = _document(
        {
            "effect": entry.effect,
            "sensor": sensor,
            "axis": entry.axis,
            "parameters": {
                name: {"value": value.value, "unit": spelled_like(value.unit, _declared_unit(neutral, name))}
                for name, value in written.items()
            },
        }
    )
    (effect,) = parse_twin(document, place).effects
    return FoundEffect(effect, tuple(written), tuple(left_out))


def _sensor(entry: Attribution, place: str) -> SensorName:
    if entry.effect not in CATALOGUE:
        raise refused(
            f"There is no effect '{entry.effect}'.", place, "'testloom emulator effects' lists them all."
        )
    sensors = CATALOGUE[entry.effect][1]
    said = (
        {channel.partition("_")[0] for channel in entry.channels} if entry.sensor is None else {entry.sensor}
    )
    fitting: list[SensorName] = [sensor for sensor in sensors if sensor in said] or (
        list(sensors) if entry.sensor is None else []
    )
    if len(fitting) != 1:
        raise refused(
            f"The report does not say on which triad '{entry.effect}' acts.",
            place,
            f"give it a sensor: {' or '.join(sensors)}.",
        )
    return fitting[0]


def _scalar_names(neutral: CatalogueEffect, name: str, channels: Sequence[str]) -> tuple[str, ...]:
    """A scalar's own name; also a matrix's column ('acc_y') or a whole triple, on the channels stated."""
    own = {scalar.name for scalar in scalars(neutral)}
    if name in own:
        return (name,)
    axes = [channel[-1] for channel in channels if channel[-1:] in AXES]
    field, _, column = name.rpartition("_")
    for written in (f"{field}_{{axis}}{column}" if column in AXES and field else "", f"{name}_{{axis}}"):
        found = tuple(written.format(axis=axis) for axis in axes) if written else ()
        if found and own.issuperset(found):
            return found
    return (name,)  # a power of a polynomial, or to be refused as it was written


def _declared_unit(neutral: CatalogueEffect, parameter: str) -> str:
    units = {
        field: unit_for(declaration.unit, neutral.sensor)
        for field, declaration in declarations(neutral).items()
    }
    fields = [field for field in units if parameter == field or parameter.startswith(f"{field}_")]
    return units[max(fields, key=len)] if fields else ""


def _merged(own: CatalogueEffect, found: FoundEffect, where: str) -> CatalogueEffect:
    """The twin's own effect with the parameters that the report states."""
    stated = found.stated
    had = {scalar.name: scalar for scalar in scalars(own)}
    has = {scalar.name: scalar for scalar in scalars(found.effect)}
    others = [s.name for s in had.values() if not s.held and s.value and s.name not in stated]
    other_shape = [
        name
        for name in stated
        if has[name].held and not math.isclose(has[name].value, had[name].value, rel_tol=_SAME)
    ]
    axis = getattr(found.effect, "axis", None)
    if axis != getattr(own, "axis", None):
        other_shape.append("axis")
    if others and other_shape:
        raise refused(
            f"The twin has '{name_of(own)}' with {', '.join(others)}, and another {', '.join(other_shape)}.",
            where,
            "take it out of the twin, or diagnose with all of its channels.",
        )
    entry: dict[str, Any] = json.loads(twin_text(Twin(effects=(own,))))["effects"][0]
    for name in stated:
        value = has[name].value
        if own.word in ADDS_TO_BELIEVED and not has[name].held:
            value += had[name].value
        entry["parameters"][name] = {"value": value, "unit": has[name].unit}
    (merged,) = parse_twin(_document({**entry, "axis": axis}), where).effects
    return merged


def _changes(
    own: CatalogueEffect | None, merged: CatalogueEffect, found: FoundEffect
) -> list[ParameterChange]:
    before = {} if own is None else {scalar.name: scalar.value for scalar in scalars(own)}
    changes: list[ParameterChange] = []
    for scalar in scalars(merged):
        if scalar.name not in (*found.stated, *found.left_out):
            continue
        how: How = "new" if own is None else "added" if own.word in ADDS_TO_BELIEVED else "replaced"
        how = "shape" if scalar.held else "left out" if scalar.name in found.left_out else how
        was = before.get(scalar.name, 0.0) if own is not None else None
        changes.append(
            ParameterChange(name_of(merged), merged.sensor, scalar.name, was, scalar.value, scalar.unit, how)
        )
    return changes


def _document(entry: Mapping[str, Any]) -> str:
    return json.dumps({"format": TWIN_FORMAT, "product": "", "effects": [entry]})


def _key(effect: CatalogueEffect) -> tuple[str, str]:
    return effect.sensor, name_of(effect)
