# pyright: strict
"""The gyro as a recorder sees it.

Column `gyro_z` holds the output Q in counts as it is sent (20,000 a °/s, 2000 at rest), `temp` the coil's
temperature in steps of 0.01 °C, `counter` the frames' 8-bit number. On the impact rig, `stamp` is what the
rig's acquisition module puts to each frame (`protocol.impact_rig`); there the profile says the frame rate,
since the lag depends on it. `t` is when a frame's last byte came.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import Bias, Misalignment, ScaleFactorError
from dut_emulator.effects.dynamics import Bandwidth
from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.lot import LotDraw
from dut_emulator.lot_defects import defects_of
from dut_emulator.motion.impact_profile import StampsFrames
from dut_emulator.motion.run import Run
from dut_emulator.products.fog import population
from dut_emulator.products.fog.sensor import INPUT_AXIS, Acting, FogSensor, check_frame_rate
from dut_emulator.products.product import Mounting, StreamShape, UnitOnStand, UnitStreams, sample_times_s
from dut_emulator.twin import Twin
from protocol.fog import (
    COUNTS_PER_DEG_S,
    DEFAULT_FRAME_RATE_HZ,
    RANGE_DEG_S,
    TEMPERATURE_LSB_C,
    ZERO_RATE_COUNTS,
)
from protocol.units_of_measure import conversion_factor

_SLOW_RATE_HZ, _THERMAL_RATE_HZ = 500.0, 20.0
"""Frame rates for tests of minutes and of hours."""
_TEMPERATURE_STEPS = round(1 / TEMPERATURE_LSB_C)
"""In a °C: dividing by a whole number gives the nearest double of what is meant."""


class Fog:
    """See `Product`."""

    name = population.PRODUCT_NAME
    profiles: Mapping[str, Mounting] = {
        "impact": Mounting("impact_rig", DEFAULT_FRAME_RATE_HZ),
        "static": Mounting("three_axis_turntable", _SLOW_RATE_HZ),
        "rate_staircase": Mounting("three_axis_turntable", _SLOW_RATE_HZ),
        "sweep": Mounting("three_axis_turntable", DEFAULT_FRAME_RATE_HZ),
        "temperature_ramp": Mounting("thermal_turntable", _THERMAL_RATE_HZ),
    }

    def twin(self, seed: int, serial: str) -> Twin:
        """See `Product`."""
        return population.draw_twin(seed, serial)

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """See `Product`."""
        return tuple(defect.name for defect in defects_of(LotDraw(seed, serial), population.DEFECTS))

    def believed(self, twin: Twin) -> dict[str, Any]:
        """See `Product`. Figures in deg/s; `counts` says how the column `gyro_z` holds them."""
        axis = INPUT_AXIS
        matrix = [[0.0, 0.0, 0.0] for _ in range(3)]
        matrix[axis][axis] = 1.0
        bias = [0.0, 0.0, 0.0]
        gyro: dict[str, Any] = {
            "unit": "deg/s",
            "counts": {"per_unit": COUNTS_PER_DEG_S, "at_zero": ZERO_RATE_COUNTS},
            "quantum": 1.0 / COUNTS_PER_DEG_S,
            "range": RANGE_DEG_S,
            "bandwidth_hz": None,
        }
        for effect in twin.effects:
            match effect:
                case Misalignment():
                    for column in range(axis):
                        matrix[axis][column] = effect.misalignment_rad[axis][column]
                case ScaleFactorError():
                    factor = 1.0 + effect.scale_factor_error[axis]
                    matrix[axis] = [factor * element for element in matrix[axis]]
                case Bias():
                    bias[axis] = effect.bias_si[axis] * conversion_factor("rad/s", "deg/s")
                case Bandwidth() if effect.time_constant_s > 0:
                    gyro["bandwidth_hz"] = 1.0 / (2 * np.pi * effect.time_constant_s)
                case _:
                    gyro |= _noise(effect)
        return {"gyro": {"matrix": matrix, "bias": bias, **gyro}, "earth_rate": True}

    def begin(self, unit: UnitOnStand) -> UnitStreams:
        """See `Product`. Raises besides: a frame rate that the gyro has not."""
        rate_hz = unit.run.frame_rate_hz if isinstance(unit.run, StampsFrames) else unit.rate_hz
        check_frame_rate(rate_hz)
        return FogStreams(unit, rate_hz)


PRODUCT = Fog()


class FogStreams:
    """See `UnitStreams`."""

    def __init__(self, unit: UnitOnStand, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._acting = from_the_start(unit.run)
        self._stamping = unit.run if isinstance(unit.run, StampsFrames) else None
        self._sensor = FogSensor(unit.twin, unit.stand_effects, unit.seed, unit.power_on_s)
        self._sent = 0

    @property
    def shapes(self) -> tuple[StreamShape, ...]:
        """One stream; with stamps on a stand that makes them."""
        units = {"t": "s", "gyro_z": "1", "temp": "degC", "counter": "1"}
        types = {"t": "float64", "gyro_z": "int32", "temp": "float64", "counter": "uint8"}
        if self._stamping is not None:
            units["stamp"], types["stamp"] = "1", "uint16"
        return (StreamShape("dut", units, types),)

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """See `UnitStreams`. A lost frame leaves a hole; the counter counts it."""
        times_s = sample_times_s(self._sent, to_s, self._rate_hz)
        counters = (self._sent + np.arange(len(times_s))).astype(np.uint8)
        self._sent += len(times_s)
        samples = self._sensor.sample(times_s, self._rate_hz, self._acting)
        there = ~samples.lost
        columns: dict[str, NDArray[Any]] = {
            "t": times_s[there],
            "gyro_z": samples.rate[there],
            "temp": samples.temperature[there] / _TEMPERATURE_STEPS,
            "counter": counters[there],
        }
        if self._stamping is not None:
            columns["stamp"] = self._stamping.stamps(times_s[there])
        return {"dut": columns}


def from_the_start(run: Run) -> Acting:
    """What acts on the unit in a run; before its start, what acts at the start."""

    def acting(times_s: FloatArray) -> Stimulus:
        return run.stimulus(np.maximum(times_s, 0.0))

    return acting


def _noise(effect: CatalogueEffect) -> dict[str, Any]:
    """The lot's figures, not the unit's own: what a data sheet says."""
    match effect:
        case WhiteNoise():
            density = population.NOISE_DENSITY_RAD_SQRT_S * conversion_factor("rad/sqrt(s)", "deg/sqrt(h)")
            spread = population.NOISE_UNIT_SPREAD
            return {"angle_random_walk": {"value": density, "unit": "deg/sqrt(h)", "unit_spread": spread}}
        case BiasInstability():
            return {
                "bias_instability": {
                    "value": population.BIAS_INSTABILITY_DEG_H,
                    "unit": "deg/h",
                    "unit_spread": population.INSTABILITY_UNIT_SPREAD,
                    "correlation_time_s": population.CORRELATION_TIME_S,
                }
            }
        case _:
            return {}
