# pyright: strict
"""Units of a lot that are not as they should be: defects, each at a stated rate.

A defect multiplies one parameter of one effect and adds to it, on one axis that is drawn where there are
three. Whether a unit has it depends on lot seed, serial number and the defect's name alone.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import SensorName, name_of
from dut_emulator.lot import LotDraw
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError


@dataclass(frozen=True)
class LotDefect:
    """A way in which units go wrong.

    Attributes:
        name: what a person calls it.
        rate: the share of units that have it.
        effect, sensor, field: the parameter, such as 'gyro.bias', 'gyro', 'bias_si'.
        factor, shift: true value = factor · drawn value + shift, in the parameter's SI unit.
        axes: indices of which one is hit; of a matrix a whole row, a single number as it is.
    """

    name: str
    rate: float
    effect: str
    sensor: SensorName
    field: str
    factor: float = 1.0
    shift: float = 0.0
    axes: tuple[int, ...] = (0, 1, 2)


def defects_of(draw: LotDraw, defects: Sequence[LotDefect]) -> tuple[LotDefect, ...]:
    """Those that this unit has."""
    return tuple(defect for defect in defects if draw.happens(defect.name, defect.rate))


def with_defects(twin: Twin, draw: LotDraw, defects: Sequence[LotDefect]) -> Twin:
    """The unit as it left the factory: its drawn effects, and what went wrong with it.

    Raises:
        TestloomError: a defect of an effect that the unit has not.
    """
    for defect in defects_of(draw, defects):
        twin = _hit(twin, defect, draw)
    return twin


def _hit(twin: Twin, defect: LotDefect, draw: LotDraw) -> Twin:
    found = [
        effect
        for effect in twin.effects
        if name_of(effect) == defect.effect and effect.sensor == defect.sensor
    ]
    if not found:
        raise TestloomError(
            f"The defect '{defect.name}' is one of {defect.effect}, which the unit has not.",
            where=f"lot of {twin.product}",
            fault=Fault.TESTLOOM,
            remedy="correct the product's table of defects.",
        )
    value = np.array(getattr(found[0], defect.field), dtype=np.float64)
    where = () if value.ndim == 0 else (defect.axes[draw.index(f"axis of {defect.name}", len(defect.axes))],)
    value[where] = defect.factor * value[where] + defect.shift
    change: Any = {defect.field: _nested(value.tolist())}
    return twin.with_effect(dataclasses.replace(found[0], **change))


def _nested(value: Any) -> Any:
    return tuple(_nested(item) for item in cast(list[Any], value)) if isinstance(value, list) else value
