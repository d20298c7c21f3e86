# pyright: strict
"""The MEMS attitude unit of paper 2 as a product: where it is tested, what it is, what a recording holds."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray
from dut_emulator.lot import LotDraw
from dut_emulator.lot_defects import defects_of
from dut_emulator.products.mems_ahrs import cooling
from dut_emulator.products.mems_ahrs.compensation import Flash
from dut_emulator.products.mems_ahrs.sampling import SENSORS, Ahrs, Housing, check_twin
from dut_emulator.products.mems_ahrs.unit_effects import (
    BIAS_CORRELATION_TIME_S,
    DEFECTS,
    NOISE_UNIT_SPREAD,
    TURN_ON_DEVIATION,
    draw_twin,
)
from dut_emulator.products.product import (
    Mounting,
    Product,
    StreamShape,
    UnitOnStand,
    UnitStreams,
    chain_effects,
    sample_times_s,
)
from dut_emulator.twin import Twin
from protocol.mems_ahrs import (
    ACC_LSB_G,
    ATTITUDE_LSB_DEG,
    GYRO_LSB_DEG_S,
    SUPPLY_NOMINAL_V,
    TEMPERATURE_LSB_C,
)
from protocol.units_of_measure import factor_to_si

_TURNTABLE = Mounting("two_axis_turntable", 200.0)
_CHAMBER = Mounting("thermal_turntable", 100.0)
_VEHICLE = Mounting("vehicle_run_stand", 100.0)
_PROFILES: dict[str, Mounting] = {
    "static": _TURNTABLE,
    "multi_position": _TURNTABLE,
    "rotation": _TURNTABLE,
    "rate_staircase": _TURNTABLE,
    "tumble": _TURNTABLE,
    "swing": _TURNTABLE,
    "sweep": _TURNTABLE,
    "temperature_ramp": _CHAMBER,
    "thermal_positions": _CHAMBER,
    "vehicle_run": _VEHICLE,
    "flight": _VEHICLE,
}

SHAPE = StreamShape(
    name="dut",
    units={
        "t": "s",
        **{f"gyro_{axis}": "deg/s" for axis in "xyz"},
        **{f"acc_{axis}": "g" for axis in "xyz"},
        "temp": "degC",
        "temp_gyro": "degC",
        "temp_acc": "degC",
        "roll": "deg",
        "pitch": "deg",
        "yaw": "deg",
        "counter": "1",
        "flags": "1",
    },
    types={
        "t": "float64",
        **{f"{triad}_{axis}": "float64" for triad in SENSORS for axis in "xyz"},
        **dict.fromkeys(("temp", "temp_gyro", "temp_acc", "roll", "pitch", "yaw"), "float64"),
        "counter": "uint32",
        "flags": "uint16",
    },
)


@dataclass(frozen=True)
class MemsAhrs:
    """See `Product`. As it is made: with paste, in the measured housing, and nothing corrected.

    Attributes:
        flash: with what is written to it, the recorded gyros and accelerometers are corrected ones.
        scheme, parameters: how it is cooled.
    """

    flash: Flash = field(default_factory=Flash)
    scheme: cooling.Cooling = cooling.Cooling.PASTE
    parameters: cooling.HousingSet = cooling.AS_MEASURED

    @property
    def name(self) -> str:
        """As in design and twin files."""
        return "mems_ahrs"

    @property
    def profiles(self) -> Mapping[str, Mounting]:
        """Profile → where it is run."""
        return _PROFILES

    def twin(self, seed: int, serial: str) -> Twin:
        """The unit of this serial number in the lot of this seed."""
        return draw_twin(seed, serial)

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """See `Product`."""
        return tuple(defect.name for defect in defects_of(LotDraw(seed, serial), DEFECTS))

    def believed(self, twin: Twin) -> dict[str, Any]:
        """Matrix, bias, noise, quantum, range and bandwidth of both triads."""
        rate_noise = ("angle_random_walk", "deg/sqrt(h)")
        return {
            "gyro": _believed_triad(twin, "gyro", "deg/s", rate_noise, "deg/h"),
            "acc": _believed_triad(twin, "acc", "g", ("velocity_random_walk", "m/s/sqrt(h)"), "mg"),
            "earth_rate": True,
        }

    def begin(self, unit: UnitOnStand) -> UnitStreams:
        """Power the unit on this stand; it streams from 0 s on."""
        return _Streams(unit, self)


PRODUCT: Product = MemsAhrs()


class _Streams:
    """See `UnitStreams`."""

    shapes: tuple[StreamShape, ...] = (SHAPE,)

    def __init__(self, unit: UnitOnStand, product: MemsAhrs) -> None:
        self._unit = unit
        self._period_s = 1.0 / unit.rate_hz
        self._next = 0
        self._compensated = not product.flash.is_blank
        check_twin(unit.twin)
        warmth, *triads = (
            chain_effects(unit.twin, unit.stand_effects, sensor) for sensor in ("temperature", *SENSORS)
        )
        housing = Housing(product.parameters, product.scheme, warmth)
        housing.settle(unit.run.stimulus(np.zeros(1)), unit.power_on_s)
        housing.heat_w = cooling.heat_w(SUPPLY_NOMINAL_V, unit.rate_hz)
        self._ahrs = Ahrs(itertools.chain(*triads), housing, product.flash, unit.seed, unit.power_on_s)
        self._ahrs.begin_stream(self._period_s)

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """Samples up to `to_s`."""
        times_s = sample_times_s(self._next, to_s, self._unit.rate_hz)
        first, self._next = self._next, self._next + len(times_s)
        samples = self._ahrs.sample(
            self._unit.run.stimulus, times_s, self._period_s, compensated=self._compensated
        )
        columns: dict[str, NDArray[Any]] = {"t": times_s}
        _add(
            columns, ("gyro_x", "gyro_y", "gyro_z"), samples.gyro_rad_s, factor_to_si("deg/s"), GYRO_LSB_DEG_S
        )
        _add(columns, ("acc_x", "acc_y", "acc_z"), samples.acc_m_s2, factor_to_si("g"), ACC_LSB_G)
        _add(columns, ("temp", "temp_gyro", "temp_acc"), samples.temperature_c, 1.0, TEMPERATURE_LSB_C)
        _add(columns, ("roll", "pitch", "yaw"), samples.attitude_rad, factor_to_si("deg"), ATTITUDE_LSB_DEG)
        columns["counter"] = np.arange(first, self._next).astype(np.uint32)
        columns["flags"] = samples.flags
        return {"dut": columns}


def _add(
    columns: dict[str, NDArray[Any]],
    names: tuple[str, ...],
    values: FloatArray,
    factor: float,
    quantum: float,
) -> None:
    """Columns as the unit sends them: whole numbers of a quantum, in the recording's unit."""
    for name, column in zip(names, values.T, strict=True):
        columns[name] = np.rint(column / (factor * quantum)) * quantum


def _believed_triad(
    twin: Twin, sensor: str, unit: str, white: tuple[str, str], slow_unit: str
) -> dict[str, Any]:
    own: dict[str, CatalogueEffect] = {
        effect.word: effect for effect in twin.effects if effect.sensor == sensor
    }

    def triple(word: str, field: str) -> FloatArray:
        return np.asarray(getattr(own[word], field) if word in own else (0.0, 0.0, 0.0), dtype=np.float64)

    turned = own.get("misalignment")
    misalignment = np.asarray(getattr(turned, "misalignment_rad", np.zeros((3, 3))))
    scale = 1.0 + triple("scale_factor_error", "scale_factor_error")
    matrix = scale[:, np.newaxis] * (np.eye(3) + misalignment)
    si = factor_to_si(unit)
    white_name, white_unit = white
    density = float(triple("white_noise", "density_si_per_sqrt_hz").mean()) / factor_to_si(white_unit)
    slow = float(triple("bias_instability", "standard_deviation_si").mean()) / factor_to_si(slow_unit)
    lag_s = float(getattr(own.get("bandwidth"), "time_constant_s", 0.0))
    quantum_si = float(getattr(own.get("quantization"), "quantum_si", 0.0))
    range_si = float(getattr(own.get("saturation"), "range_si", np.inf))
    turn_on = TURN_ON_DEVIATION[sensor] / factor_to_si(slow_unit) if "bias" in own else 0.0
    return {
        "matrix": matrix.tolist(),
        "bias": (triple("bias", "bias_si") / si).tolist(),
        "unit": unit,
        white_name: {"value": density, "unit": white_unit, "unit_spread": NOISE_UNIT_SPREAD},
        "bias_instability": {
            "value": slow,
            "unit": slow_unit,
            "unit_spread": NOISE_UNIT_SPREAD,
            "correlation_time_s": BIAS_CORRELATION_TIME_S,
        },
        **({"turn_on_repeatability": {"value": turn_on, "unit": slow_unit}} if turn_on else {}),
        "quantum": quantum_si / si or None,
        "range": range_si / si if np.isfinite(range_si) else None,
        "bandwidth_hz": 1.0 / (2.0 * np.pi * lag_s) if lag_s else None,
    }
