# pyright: strict
"""The `believed` object of a recording, from a twin: matrix, bias, noise, quantum, range."""

from typing import Any

import numpy as np

from dut_emulator.effects.deterministic import Bias, Misalignment, ScaleFactorError
from dut_emulator.effects.effect import FloatArray, SensorName
from dut_emulator.effects.fields_and_tones import HardIron, SoftIron
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.twin import Twin
from protocol import gnc_module as product
from protocol.units_of_measure import factor_to_si

NOISE_SPREAD = 0.15
"""Of the white noise's logarithm over units and axes."""
_KNOWN: dict[SensorName, tuple[str, float, float, str, str]] = {
    "gyro": (
        *("deg/s", product.GYRO_LSB_DEG_S, product.GYRO_RANGE_DEG_S),
        *("angle_random_walk", "deg/sqrt(h)"),
    ),
    "acc": ("g", product.ACC_LSB_G, product.ACC_RANGE_G, "velocity_random_walk", "m/s/sqrt(h)"),
    "mag": ("gauss", product.MAG_LSB_GAUSS, product.MAG_RANGE_GAUSS, "white_noise", "uT/sqrt(Hz)"),
}
"""Sensor → unit, quantum, range, word and unit of its white noise: the format has none for fields."""
_SLOW_UNIT: dict[SensorName, str] = {"gyro": "deg/h", "acc": "mg", "mag": "uT"}
_TURN_ON = {
    "gyro": (product.GYRO_TURN_ON_REPEATABILITY_DEG_H, "deg/h"),
    "acc": (product.ACC_TURN_ON_REPEATABILITY_MG, "mg"),
}


def believed_of(twin: Twin) -> dict[str, Any]:
    """Per triad. The receiver's part has no words in the format. Runs include the Earth rate."""
    return {**{sensor: _triad(twin, sensor) for sensor in _KNOWN}, "earth_rate": True}


def _triad(twin: Twin, sensor: SensorName) -> dict[str, Any]:
    unit, quantum, span, word, density_unit = _KNOWN[sensor]
    matrix, bias = _matrix_and_bias(twin, sensor)
    said: dict[str, Any] = {
        "matrix": matrix.tolist(),
        "bias": (bias / factor_to_si(unit)).tolist(),
        **{"unit": unit, "quantum": quantum, "range": span, "bandwidth_hz": None},
    }
    for effect in twin.effects:
        if effect.sensor != sensor:
            continue
        if isinstance(effect, WhiteNoise):
            level = _typical(effect.density_si_per_sqrt_hz) / factor_to_si(density_unit)
            said[word] = {"value": level, "unit": density_unit, "unit_spread": NOISE_SPREAD}
        elif isinstance(effect, BiasInstability):
            said["bias_instability"] = {
                "value": _typical(effect.standard_deviation_si) / factor_to_si(_SLOW_UNIT[sensor]),
                "unit": _SLOW_UNIT[sensor],
                "unit_spread": product.BIAS_INSTABILITY_UNIT_SPREAD,
                "correlation_time_s": effect.correlation_time_s,
            }
    if sensor in _TURN_ON:
        value, turn_on_unit = _TURN_ON[sensor]
        said["turn_on_repeatability"] = {"value": value, "unit": turn_on_unit}
    return said


def _matrix_and_bias(twin: Twin, sensor: SensorName) -> tuple[FloatArray, FloatArray]:
    """y = matrix · u + bias at 25 °C, from what acts before the noise."""
    matrix, scale, bias = np.eye(3), np.ones(3), np.zeros(3)
    for effect in twin.effects:
        if effect.sensor != sensor:
            continue
        match effect:
            case Misalignment():
                matrix = (np.eye(3) + np.asarray(effect.misalignment_rad)) @ matrix
            case SoftIron():
                matrix = (np.eye(3) + np.asarray(effect.matrix)) @ matrix
            case ScaleFactorError():
                scale = 1.0 + np.asarray(effect.scale_factor_error)
            case Bias():
                bias = bias + np.asarray(effect.bias_si)
            case HardIron():
                bias = bias + np.asarray(effect.field_t)
            case _:
                pass
    return scale[:, np.newaxis] * matrix, bias


def _typical(levels: tuple[float, float, float]) -> float:
    """Root mean square over the axes."""
    return float(np.sqrt(np.mean(np.square(levels))))
