"""One rich motion, and for every effect parameters that it shows."""

import dataclasses
import functools
from typing import Any

import numpy as np

from dut_emulator.effects.catalogue import CATALOGUE, effect_named
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectState, Stimulus
from dut_emulator.effects.parameters import declarations, scalars, with_values

PERIOD_S = 0.01
COUNT = 400


@functools.cache
def motion(count: int = COUNT) -> Stimulus:
    """Turns, tumbles, a closed loop of temperature, a supply that sags: everything moves, nothing alike."""
    t = (1 + np.arange(count)) * PERIOD_S
    waves = np.stack([np.sin(2 * np.pi * f * t + 0.3 * f) for f in (0.31, 0.53, 0.83, 1.27, 1.9, 2.6)])
    rate = np.stack(
        [2.1 * waves[0] + 0.4 * waves[3], 1.7 * waves[1] - 0.5 * waves[4], 2.4 * waves[2]], axis=1
    )
    force = np.stack([12 * waves[3] + 2 * waves[0], 9.8 * waves[4], 9.8 + 11 * waves[5]], axis=1)
    field = 4e-5 * np.stack([waves[1], waves[5] + 0.2, waves[0] - 0.4], axis=1)
    angles = np.stack([1.1 * t + 0.3 * waves[0], 0.7 * waves[1] + 0.2, 2.3 * t - 0.5 * waves[2]], axis=1)
    attitude = np.stack([_rotation(a, b) for a, b in zip(angles[:, 0], angles[:, 1], strict=True)])
    return Stimulus(
        time_s=t,
        temperature_c=20 + 30 * np.sin(np.pi * t / (COUNT * PERIOD_S)) + 8 * waves[1],
        sample_period_s=PERIOD_S,
        rate_rad_s=rate,
        specific_force_m_s2=force,
        field_t=field,
        supply_v=5 + 0.3 * waves[2] - 0.1 * waves[5],
        supply_current_a=0.3 + 0.1 * waves[4],
        angles_rad=angles,
        earth_rate_rad_s=7.292115e-5
        * np.stack([np.cos(angles[:, 2]), np.sin(angles[:, 2]), waves[0]], axis=1),
        position_m=50 * waves[:3].T + t[:, np.newaxis] * np.array([3.0, -2.0, 0.5]),
        dcm_local_from_body=attitude,
        power_on_s=0.5,
    )


def _rotation(a: float, b: float) -> np.ndarray:
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    return np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])


def part(whole: Stimulus, start: int, stop: int) -> Stimulus:
    """A chunk of a stimulus."""
    rows = {
        field.name: getattr(whole, field.name)[start:stop]
        for field in dataclasses.fields(whole)
        if isinstance(getattr(whole, field.name), np.ndarray)
    }
    return dataclasses.replace(whole, **rows)


def applied(effect: Any, samples: np.ndarray, stimulus: Stimulus, seed: int = 1) -> np.ndarray:
    rng = np.random.Generator(np.random.SFC64(seed))
    return effect.apply(samples, stimulus, rng, EffectState())


def at_neutral(effect: Any) -> Any:
    """The effect with its free parameters at 0 and its held ones as they are."""
    return with_values(effect, {scalar.name: 0.0 for scalar in scalars(effect, free_only=True)})


_OFF = ((0.0, 0.01, -0.02), (0.003, 0.0, 0.004), (-0.005, 0.006, 0.0))
_FULL = ((0.01, -0.02, 0.03), (0.004, 0.005, -0.006), (-0.007, 0.008, 0.009))
_A, _B, _C = (0.01, -0.02, 0.03), (-0.004, 0.005, 0.006), (0.007, 0.008, -0.009)


def scaled(values: Any, factor: float) -> Any:
    """Nested tuples times a number."""
    return tuple(scaled(v, factor) for v in values) if isinstance(values, tuple) else values * factor


PARAMETERS: dict[str, dict[str, Any]] = {
    "misalignment": {"misalignment_rad": _OFF},
    "scale_factor_error": {"scale_factor_error": _A},
    "bias": {"bias_si": _A},
    "bias_temperature": {"coefficients_si_per_c": (scaled(_A, 0.1), scaled(_B, 0.01))},
    "scale_factor_temperature": {"coefficients_per_c": (scaled(_A, 0.1), scaled(_B, 0.01))},
    "misalignment_temperature": {"misalignment_rad_per_c": scaled(_OFF, 0.05)},
    "temperature_rate": {"coefficient_rad_per_c": _A},
    "thermal_hysteresis": {"amplitude_si": _A, "half_width_c": 7.0},
    "warm_up": {"amplitude_si": _A, "time_constant_s": 1.7},
    "scale_factor_asymmetry": {"asymmetry": _A},
    "scale_factor_nonlinearity": {"cubic": scaled(_A, 2e-3)},
    "even_nonlinearity": {"square": _B},
    "quadratic_nonlinearity": {"square": scaled(_B, 0.01)},
    "odd_quadratic_nonlinearity": {"odd_square": scaled(_B, 0.01)},
    "cubic_nonlinearity": {"cubic": scaled(_A, 5e-6)},
    "dead_band": {"depth": (1.0, 0.9, 0.8), "half_width_si": 0.3},
    "rate_hysteresis": {"amplitude_si": _A, "half_width_si": 0.4},
    "g_sensitivity": {"acc": scaled(_FULL, 0.01)},
    "g2_sensitivity": {"acc_squared": scaled(_FULL, 0.001)},
    "supply_sensitivity": {"per_volt_si": _A, "nominal_v": 4.9},
    "magnetic_sensitivity": {"field": _FULL},
    "cross_axis_sensitivity": {"cross": _OFF},
    "vibration_rectification": {"coefficient_per_si": scaled(_A, 0.01), "averaging_time_s": 0.6},
    "size_effect": {"place_x_m": _A, "place_y_m": _B, "place_z_m": _C},
    "shock_bias_shift": {"shift_si": _A, "threshold_si": 19.0},
    "bandwidth": {"time_constant_s": 0.013},
    "white_noise": {"density_si_per_sqrt_hz": (1e-3, 2e-3, 3e-3)},
    "bias_instability": {"standard_deviation_si": (1e-3, 2e-3, 3e-3), "correlation_time_s": 0.2},
    "flicker_noise": {"coefficient_si": (1e-3, 2e-3, 3e-3), "shortest_time_s": 0.05, "longest_time_s": 51.2},
    "rate_random_walk": {"coefficient_si_per_sqrt_s": (1e-3, 2e-3, 3e-3)},
    "saturation": {"range_si": 1.5},
    "quantization": {"quantum_si": 0.013},
    "hard_iron": {"field_t": scaled(_A, 1e-3)},
    "soft_iron": {"matrix": _FULL},
    "current_coupling": {"per_ampere_t": scaled(_A, 1e-3)},
    "mains_interference": {"cosine_si": scaled(_A, 1e-4), "sine_si": scaled(_B, 1e-4), "frequency_hz": 53.0},
    "latency": {"latency_s": 0.123},
    "clock_step": {"step_s": 0.037, "at_s": 1.234},
    "antenna_lever_arm": {"arm_m": (0.4, -0.3, 1.2)},
    "multipath": {"standard_deviation_si": (1.0, 2.0, 3.0), "correlation_time_s": 0.2},
    "fixed_delay": {"delay_s": 0.0133},
    "clock_drift": {"relative_rate": 2.7e-3},
    "timestamp_jitter": {"deviation_s": 1e-3},
    "frame_loss": {"probability": 0.05},
    "duplicate_frames": {"probability": 0.05},
    "counter_wrap": {"half_span_si": 1.1},
    "aliasing": {"cosine_si": _A, "sine_si": _B, "frequency_hz": 1010.0},
    "wobble": {"cosine_rad": scaled(_A, 0.1), "sine_rad": scaled(_B, 0.1), "harmonic": 2.0, "axis": "middle"},
    "rate_ripple": {"cosine": 0.01, "sine": -0.02, "harmonic": 5.0, "axis": "outer"},
    "encoder_eccentricity": {"cosine_rad": 0.003, "sine_rad": -0.002, "axis": "middle"},
    "remount_misalignment": {"rotation_rad": _A},
    "earth_rate": {"share": 1.0},
    "lever_arm": {"arm_m": _A},
    "motor_field": {"cosine_t": scaled(_A, 1e-4), "sine_t": scaled(_B, 1e-4), "harmonic": 3.0},
    "chamber_gradient": {"share": _A, "room_c": 22.0},
    "chamber_lag": {"time_constant_s": 0.9},
    "level_drift": {"tilt_rate_rad_s": scaled(_A, 0.02)},
    "non_orthogonality": {"outer_middle_rad": 0.01, "middle_inner_rad": -0.02},
    "rate_scale_factor": {"share": 0.004},
    "crank_geometry": {"ratio": 0.2, "radius_m": 0.12, "stroke": (0.6, 0.0, -0.8)},
}
_FIELD_SCALE = 2e-5  # a magnetometer's example is that much smaller than a gyro's


def _example(name: str, sensor: Any) -> CatalogueEffect:
    neutral = effect_named(name, sensor)
    parameters = dict(PARAMETERS[neutral.word])
    if sensor == "mag":
        for field, declaration in declarations(neutral).items():
            own = declaration.unit.startswith("{") and "_t" not in field and "e-4" not in str(parameters)
            if field in parameters and own and neutral.word not in ("mains_interference",):
                parameters[field] = scaled(parameters[field], _FIELD_SCALE)
    return dataclasses.replace(neutral, **parameters)


EXAMPLES: dict[str, CatalogueEffect] = {
    f"{name} on {sensor}": _example(name, sensor) for name, (_, able) in CATALOGUE.items() for sensor in able
}
for _word in ("rate_ripple", "encoder_eccentricity"):
    _axis: Any = {"axis": "inner"}
    EXAMPLES[f"stand.{_word} of the inner axis"] = dataclasses.replace(
        EXAMPLES[f"stand.{_word} on gyro"], **_axis
    )
DETERMINISTIC = sorted(name for name, effect in EXAMPLES.items() if not effect.stochastic)
STOCHASTIC = sorted(name for name, effect in EXAMPLES.items() if effect.stochastic)
