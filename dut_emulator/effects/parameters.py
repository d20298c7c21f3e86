# pyright: strict
"""What an effect's parameters mean: unit, range, and which of them are fitted.

A parameter is a field of the effect: a number, a triple (x, y, z) or a matrix (rows are sensors). It is
taken apart into scalars for fitting and for files: `asymmetry` into `asymmetry_x`, `asymmetry_y`,
`asymmetry_z`; a matrix `m` into `m_xy` (sensor x, input y) and so on; rows of a polynomial into `c_1_x` …

A unit is written as in `protocol.units_of_measure`, with ' per ' between it and what it is divided by:
'rad/s per degC', 'deg/s per g', '1 per rad/s per rad/s'. `{si}` stands for the SI unit of the triad.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from dut_emulator.effects.effect import SI_UNIT, FloatArray, SensorName
from protocol.errors import Fault, TestloomError
from protocol.units_of_measure import factor_to_si, quantity_of

AXES = "xyz"
Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]
ZERO: Triple = (0.0, 0.0, 0.0)
ZERO_MATRIX: Matrix = (ZERO, ZERO, ZERO)

_ROOTS = {
    "sqrt(s)": ("root of time", 1.0),
    "sqrt(h)": ("root of time", 60.0),
    "sqrt(Hz)": ("root of Hz", 1.0),
}
_DENSITY = {"gyro": "rad/sqrt(s)", "acc": "m/s/sqrt(s)"}

WIDEST_INPUT_SI: dict[SensorName, float] = {
    "gyro": 100.0,
    "acc": 2000.0,
    "mag": 0.01,
    "gnss": 1e6,
    "temperature": 300.0,
}
"""Inputs that no unit of these products goes beyond. Ranges in units with `{si}` are shares of it."""

E = TypeVar("E")


@dataclass(frozen=True)
class Declaration:
    """How a field of an effect is to be read. A held parameter gives a shape and no column of a basis."""

    unit: str
    low: float
    high: float
    meaning: str
    held: bool = False
    off_diagonal: bool = False
    powers: bool = False


@dataclass(frozen=True)
class Scalar:
    """One number of an effect: its name, where it is, and what it may be."""

    name: str
    field: str
    index: tuple[int, ...]
    value: float
    unit: str
    low: float
    high: float
    held: bool


def parameter(
    default: Any,
    unit: str,
    span: tuple[float, float],
    meaning: str,
    *,
    held: bool = False,
    off_diagonal: bool = False,
    powers: bool = False,
) -> Any:
    """A field of an effect with its default, unit and range [low, high]."""
    declaration = Declaration(unit, span[0], span[1], meaning, held, off_diagonal, powers)
    return dataclasses.field(default=default, metadata={"declaration": declaration})


def declarations(kind: Any) -> dict[str, Declaration]:
    """Field → declaration, for every parameter of an effect or of a class of effects."""
    return {
        item.name: item.metadata["declaration"]
        for item in dataclasses.fields(kind)
        if "declaration" in item.metadata
    }


def unit_for(unit: str, sensor: SensorName) -> str:
    """The unit with `{si}` and `{density}` filled in for one kind of triad."""
    density = _DENSITY.get(sensor, f"{SI_UNIT[sensor]} per sqrt(Hz)")
    return unit.format(si=SI_UNIT[sensor], density=density)


def range_for(declaration: Declaration, sensor: SensorName) -> tuple[float, float]:
    """The range in the parameter's unit: times the widest input for '{si}', over it for each 'per {si}'."""
    widest, unit = WIDEST_INPUT_SI[sensor], declaration.unit
    power = unit.startswith(("{si}", "{density}")) - unit.count(" per {si}")
    return declaration.low * widest**power, declaration.high * widest**power


def scalars(effect: Any, *, free_only: bool = False) -> tuple[Scalar, ...]:
    """All numbers of an effect, in the order of its fields."""
    found: list[Scalar] = []
    for name, declaration in declarations(effect).items():
        if free_only and declaration.held:
            continue
        values = np.asarray(getattr(effect, name), dtype=np.float64)
        unit = unit_for(declaration.unit, effect.sensor)
        for index in np.ndindex(values.shape):
            if declaration.off_diagonal and index[0] == index[1]:
                continue
            suffix = _suffix(index, declaration.powers)
            low, high = range_for(declaration, effect.sensor)
            value = float(values[index])
            found.append(Scalar(name + suffix, name, index, value, unit, low, high, declaration.held))
    return tuple(found)


def _suffix(index: tuple[int, ...], powers: bool) -> str:
    if not index:
        return ""
    if len(index) == 1:
        return f"_{AXES[index[0]]}"
    if powers:
        return f"_{index[0] + 1}_{AXES[index[1]]}"
    return f"_{AXES[index[0]]}{AXES[index[1]]}"


def with_values(effect: E, values: Mapping[str, float]) -> E:
    """The effect with some of its scalars replaced.

    Raises:
        KeyError: it has no scalar of that name.
    """
    by_name = {scalar.name: scalar for scalar in scalars(effect)}
    arrays: dict[str, FloatArray] = {}
    for name, value in values.items():
        scalar = by_name[name]
        array = arrays.setdefault(scalar.field, np.array(getattr(effect, scalar.field), dtype=np.float64))
        array[scalar.index] = value
    changed: dict[str, Any] = {name: as_tuples(array) for name, array in arrays.items()}
    return dataclasses.replace(effect, **changed)  # type: ignore[type-var]


def as_tuples(array: FloatArray) -> Any:
    """An array as the nested tuples that frozen effects hold; shape () gives a float."""
    if array.ndim == 0:
        return float(array)
    return tuple(as_tuples(row) for row in array)


def check_ranges(effect: Any, where: str) -> None:
    """Refuse an effect with a parameter that is not a number or outside its range.

    Raises:
        TestloomError: names the parameter, its value and its range.
    """
    for scalar in scalars(effect):
        if math.isnan(scalar.value) or not scalar.low <= scalar.value <= scalar.high:
            raise TestloomError(
                f"{scalar.name} = {scalar.value:g} {scalar.unit} lies outside "
                f"[{scalar.low:g}, {scalar.high:g}].",
                where=where,
                fault=Fault.DATA,
                remedy="give a value inside the range, or say where a larger one was seen.",
            )
    for name, declaration in declarations(effect).items():
        if declaration.off_diagonal and np.diag(np.asarray(getattr(effect, name))).any():
            raise TestloomError(
                f"The diagonal of {name} is not zero.",
                where=where,
                fault=Fault.DATA,
                remedy="what acts along a sensor's own axis is scale factor error.",
            )


def conversion_to(unit_from: str, unit_to: str) -> float:
    """Multiply by this to go from one unit with ' per ' to another.

    Raises:
        TestloomError: a part is unknown, or the two measure different quantities.
    """
    parts_from, parts_to = unit_from.split(" per "), unit_to.split(" per ")
    quantities = [[_part(part)[0] for part in parts] for parts in (parts_from, parts_to)]
    if quantities[0] != quantities[1]:
        raise TestloomError(
            f"'{unit_from}' does not measure what '{unit_to}' measures.",
            fault=Fault.DATA,
            remedy=f"give the value in {unit_to} or in another unit of the same quantity.",
        )
    factors = [
        _part(parts[0])[1] / math.prod(_part(part)[1] for part in parts[1:])
        for parts in (parts_from, parts_to)
    ]
    return factors[0] / factors[1]


def _part(unit: str) -> tuple[str, float]:
    return _ROOTS[unit] if unit in _ROOTS else (quantity_of(unit), factor_to_si(unit))
