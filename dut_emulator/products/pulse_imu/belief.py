# pyright: strict
"""The `believed` object of a recording: the linear model and the noise, in the format's words.

The rate behind a pair of pulse columns is (pos − neg) / (sample period × `pulses_per_unit_s`), in the triad's
unit. Asymmetry, quadratic terms and g-sensitivity are not in the format: a diagnosis may find them.
"""

from typing import Any

import numpy as np

from dut_emulator.effects.couplings import CrossAxisSensitivity
from dut_emulator.effects.deterministic import Bias, Misalignment, ScaleFactorError
from dut_emulator.effects.effect import FloatArray, SensorName
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.products.pulse_imu.scale import (
    ACC_PULSES_PER_G_S,
    ACC_RANGE_G,
    GYRO_PULSES_PER_DEG,
    GYRO_RANGE_DEG_S,
)
from dut_emulator.twin import Twin
from protocol.units_of_measure import factor_to_si

NOISE_SPREAD = 0.2


def believed(twin: Twin) -> dict[str, Any]:
    """What the simulator knows of a unit with this twin; JSON-able."""
    return {
        "earth_rate": True,
        "gyro": {
            **_linear(twin, "gyro", "deg/s"),
            **_noise(twin, "gyro", "angle_random_walk", "deg/sqrt(h)", "deg/h"),
            "range": GYRO_RANGE_DEG_S,
            "pulses_per_unit_s": GYRO_PULSES_PER_DEG,
        },
        "acc": {
            **_linear(twin, "acc", "g"),
            **_noise(twin, "acc", "velocity_random_walk", "m/s/sqrt(h)", "ug"),
            "range": ACC_RANGE_G,
            "pulses_per_unit_s": ACC_PULSES_PER_G_S,
        },
    }


def _linear(twin: Twin, sensor: SensorName, unit: str) -> dict[str, Any]:
    """Matrix of couplings and scale factors, and bias, in `unit`."""
    couplings, scale, bias = np.eye(3), np.ones(3), np.zeros(3)
    for effect in twin.chain(sensor).effects:
        if isinstance(effect, Misalignment):
            couplings = couplings + np.asarray(effect.misalignment_rad)
        elif isinstance(effect, CrossAxisSensitivity):
            couplings = couplings + np.asarray(effect.cross)
        elif isinstance(effect, ScaleFactorError):
            scale = scale + np.asarray(effect.scale_factor_error)
        elif isinstance(effect, Bias):
            bias = np.asarray(effect.bias_si)
    matrix: FloatArray = scale[:, np.newaxis] * couplings
    return {
        "matrix": matrix.tolist(),
        "bias": (scale * bias / factor_to_si(unit)).tolist(),
        "unit": unit,
        "bandwidth_hz": None,
    }


def _noise(twin: Twin, sensor: SensorName, walk: str, walk_unit: str, slow_unit: str) -> dict[str, Any]:
    """Levels as the mean of the three sensors."""
    found: dict[str, Any] = {}
    for effect in twin.chain(sensor).effects:
        if isinstance(effect, WhiteNoise):
            value = float(np.mean(effect.density_si_per_sqrt_hz)) / factor_to_si(walk_unit)
            found[walk] = {"value": value, "unit": walk_unit, "unit_spread": NOISE_SPREAD}
        elif isinstance(effect, BiasInstability):
            found["bias_instability"] = {
                "value": float(np.mean(effect.standard_deviation_si)) / factor_to_si(slow_unit),
                "unit": slow_unit,
                "unit_spread": NOISE_SPREAD,
                "correlation_time_s": effect.correlation_time_s,
            }
    return found
