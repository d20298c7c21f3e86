# pyright: strict
"""What a rate gyro triad is to whoever records it.

A recording holds the three outputs as integrating converters give them: one power-line cycle (20 ms) for
each reading, 10 µV at 6½ digits.

Omitted: what a voltmeter's own gain adds (the live one has it); the spreading of motion over the 20 ms, of
which noise alone is averaged; the supply's error, for a recording is made at 15 V; the sensors' threshold,
resonance and rectification of vibration; a lever arm of the sensors, whose centripetal force would reach
the outputs through the g-sensitivity.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.deterministic import Bias, Misalignment, Saturation, ScaleFactorError
from dut_emulator.effects.dynamics import Bandwidth
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.lot import LotDraw
from dut_emulator.lot_defects import defects_of
from dut_emulator.products.product import Mounting, StreamShape, UnitOnStand, sample_times_s
from dut_emulator.products.rate_gyro_triad.analogue_gyros import AnalogueGyros
from dut_emulator.products.rate_gyro_triad.population import (
    DEFECTS,
    DEG_PER_SQRT_S,
    DEG_S,
    NOMINAL_SUPPLY_V,
    PRODUCT_NAME,
    SENSITIVITY_V_PER_RAD_S,
    drawn_twin,
)
from dut_emulator.twin import Twin

READING_RATE_HZ = 50.0
VOLT_QUANTUM_V, TEMPERATURE_QUANTUM_C = 1e-5, 0.01

SHAPE = StreamShape(
    "dut",
    units={"t": "s", "volt_x": "V", "volt_y": "V", "volt_z": "V", "temp": "degC"},
    types=dict.fromkeys(("t", "volt_x", "volt_y", "volt_z", "temp"), "float64"),
)


class RateGyroStreams:
    """See `UnitStreams`."""

    shapes = (SHAPE,)

    def __init__(self, unit: UnitOnStand) -> None:
        self._gyros = AnalogueGyros(unit.twin, unit.stand_effects, unit.seed, unit.power_on_s)
        self._run = unit.run
        self._rate_hz = unit.rate_hz
        self._taken = 0

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """The readings of (last advance, to_s]."""
        times_s = sample_times_s(self._taken, to_s, self._rate_hz)
        self._taken += len(times_s)
        acting = self._run.stimulus(times_s)
        volts, probe_c = self._gyros.sample(times_s, 1 / self._rate_hz, acting, NOMINAL_SUPPLY_V)
        volts = np.rint(volts / VOLT_QUANTUM_V) * VOLT_QUANTUM_V
        columns = {f"volt_{axis}": volts[:, index] for index, axis in enumerate("xyz")}
        probe_c = np.rint(probe_c / TEMPERATURE_QUANTUM_C) * TEMPERATURE_QUANTUM_C
        return {"dut": {"t": times_s, **columns, "temp": probe_c}}


class RateGyroTriad:
    """See `Product`."""

    name = PRODUCT_NAME
    profiles: Mapping[str, Mounting] = {
        "eleven_point": Mounting("rate_table", READING_RATE_HZ),
        "static": Mounting("rate_table", READING_RATE_HZ),
    }

    def twin(self, seed: int, serial: str) -> Twin:
        """The unit of this serial number in the lot of this seed."""
        return drawn_twin(seed, serial)

    def begin(self, unit: UnitOnStand) -> RateGyroStreams:
        """Power the unit. Raises TestloomError as `AnalogueGyros`."""
        return RateGyroStreams(unit)

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """See `Product`."""
        return tuple(defect.name for defect in defects_of(LotDraw(seed, serial), DEFECTS))

    def believed(self, twin: Twin) -> dict[str, Any]:
        """In °/s, as the format has it; `volts_per_unit` leads from there to the columns `volt_…`."""
        matrix, bias = np.eye(3), np.zeros(3)
        volts_per_unit = SENSITIVITY_V_PER_RAD_S * DEG_S
        gyro: dict[str, Any] = {
            "unit": "deg/s",
            "volts_per_unit": volts_per_unit,
            "quantum": VOLT_QUANTUM_V / volts_per_unit,
        }
        for effect in twin.effects:
            match effect:
                case Misalignment():
                    matrix = matrix + np.asarray(effect.misalignment_rad)
                case ScaleFactorError():
                    matrix = (1 + np.asarray(effect.scale_factor_error))[:, np.newaxis] * matrix
                case Bias():
                    bias = np.asarray(effect.bias_si) / DEG_S
                case WhiteNoise():
                    density = _geometric_mean(effect.density_si_per_sqrt_hz) / DEG_PER_SQRT_S
                    gyro["angle_random_walk"] = _noise(density, "deg/s/sqrt(Hz)", 0.2)
                case BiasInstability():
                    level = _geometric_mean(effect.standard_deviation_si) / DEG_S
                    time = {"correlation_time_s": effect.correlation_time_s}
                    gyro["bias_instability"] = _noise(level, "deg/s", 0.3) | time
                case Saturation():
                    gyro["range"] = effect.range_si / DEG_S if np.isfinite(effect.range_si) else None
                case Bandwidth():
                    tau_s = effect.time_constant_s
                    gyro["bandwidth_hz"] = 1 / (2 * np.pi * tau_s) if tau_s else None
                case _:  # what the format cannot say
                    pass
        return {"gyro": {"matrix": matrix.tolist(), "bias": bias.tolist(), **gyro}, "earth_rate": True}


def _geometric_mean(levels: tuple[float, float, float]) -> float:
    """One figure for a triad, as the format has it."""
    return float(np.cbrt(np.prod(levels)))


def _noise(value: float, unit: str, unit_spread: float) -> dict[str, Any]:
    return {"value": value, "unit": unit, "unit_spread": unit_spread}


PRODUCT = RateGyroTriad()
