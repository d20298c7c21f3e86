# pyright: strict
"""What each effect does, as a picture: the effect itself, applied to a motion that shows it.

Each word of the catalogue has a shot: parameters of a usual size, a motion, and what is drawn over what.
Noise is drawn with a fixed seed, beside the Allan deviation that theory gives.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dut_emulator.effects import scenes
from dut_emulator.effects.catalogue import KINDS
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stimulus
from dut_emulator.effects.line_plot import Curve, Plot
from dut_emulator.effects.link import TimestampJitter
from dut_emulator.effects.stochastic import StochasticEffect

DEG = np.pi / 180
G = 9.80665
SCALE: dict[SensorName, tuple[str, float, str, float]] = {
    "gyro": ("rate, °/s", DEG, "°/s", DEG),
    "acc": ("specific force, g", G, "mg", 1e-3 * G),
    "mag": ("field, µT", 1e-6, "µT", 1e-6),
    "gnss": ("position, m", 1.0, "m", 1.0),
    "temperature": ("temperature, °C", 1.0, "°C", 1.0),
}
"""Sensor → label and unit of its values, unit of its errors."""
AXES = "xyz"


@dataclass(frozen=True)
class Shot:
    """What a picture shows.

    Attributes:
        over: 'time', 'input', 'temperature', 'angle', 'middle', 'supply', 'current', 'rate', 'heading'.
        show: 'error' (output less input), 'both' (input and output), 'output', 'locus' (y over x), 'allan'.
        axes: those that are drawn.
    """

    parameters: dict[str, Any]
    scene: Callable[[], Stimulus]
    over: str
    show: str = "error"
    axes: tuple[int, ...] = (0, 1, 2)
    sensor: SensorName | None = None


def _off(*six: float) -> tuple[tuple[float, float, float], ...]:
    xy, xz, yx, yz, zx, zy = six
    return ((0.0, xy, xz), (yx, 0.0, yz), (zx, zy, 0.0))


def _times(factor: float, *values: float) -> tuple[float, ...]:
    return tuple(factor * value for value in values)


_RATES, _SMALL, _FORCES = scenes.sweep(300 * DEG), scenes.sweep(0.2 * DEG), scenes.sweep(10 * G)
_TIPPED = _off(2e-3, -1e-3, 1e-3, 3e-3, -2e-3, 1.5e-3)

SHOTS: dict[str, Shot] = {
    "misalignment": Shot({"misalignment_rad": _TIPPED}, scenes.sweep(300 * DEG, only_x=True), "input"),
    "scale_factor_error": Shot({"scale_factor_error": (1e-3, -5e-4, 2e-3)}, _RATES, "input"),
    "bias": Shot({"bias_si": _times(DEG, 0.2, -0.1, 0.05)}, _RATES, "input"),
    "bias_temperature": Shot(
        {"coefficients_si_per_c": (_times(DEG, 1e-3, -2e-3, 5e-4), _times(DEG, 2e-5, 1e-5, -3e-5))},
        scenes.soak,
        "temperature",
    ),
    "scale_factor_temperature": Shot(
        {"coefficients_per_c": ((1e-4, -2e-4, 5e-5), (1e-6, 1e-6, -3e-6))}, scenes.soak, "temperature"
    ),
    "misalignment_temperature": Shot(
        {"misalignment_rad_per_c": tuple(_times(0.02, *row) for row in _TIPPED)}, scenes.soak, "temperature"
    ),
    "temperature_rate": Shot({"coefficient_rad_per_c": _times(DEG, 0.5, -0.3, 0.2)}, scenes.soak, "time"),
    "thermal_hysteresis": Shot({"amplitude_si": _times(DEG, 0.02, 0.01, -0.015)}, scenes.soak, "temperature"),
    "warm_up": Shot({"amplitude_si": _times(DEG, 0.05, -0.03, 0.02)}, scenes.rest, "time"),
    "scale_factor_asymmetry": Shot({"asymmetry": (1e-3, -5e-4, 2e-4)}, _RATES, "input"),
    "scale_factor_nonlinearity": Shot({"cubic": (2e-5, -1e-5, 5e-6)}, _RATES, "input"),
    "even_nonlinearity": Shot({"square": (2e-4, -1e-4, 5e-5)}, _RATES, "input"),
    "quadratic_nonlinearity": Shot({"square": _times(1e-6 / G, 300, -200, 100)}, _FORCES, "input"),
    "odd_quadratic_nonlinearity": Shot({"odd_square": _times(1e-6 / G, 300, -200, 100)}, _FORCES, "input"),
    "cubic_nonlinearity": Shot({"cubic": _times(1e-6 / G**2, 30, -20, 10)}, _FORCES, "input"),
    "dead_band": Shot(
        {"depth": (1.0, 0.9, 0.5), "half_width_si": 0.05 * DEG}, _SMALL, "input", "output", (0, 2)
    ),
    "rate_hysteresis": Shot(
        {"amplitude_si": _times(DEG, 0.1, 0.05, -0.02), "half_width_si": 40 * DEG}, _RATES, "input"
    ),
    "g_sensitivity": Shot(
        {"acc": tuple(_times(1e-2 * DEG / G, *row) for row in ((1, 0, 0.5), (0.2, -1, 0), (0, 0.3, 0.8)))},
        scenes.turn,
        "angle",
    ),
    "g2_sensitivity": Shot(
        {"acc_squared": tuple(_times(1e-3 * DEG / G**2, *row) for row in ((1, 2, 0), (0, -1, 1), (1, 0, 2)))},
        scenes.turn,
        "angle",
    ),
    "supply_sensitivity": Shot({"per_volt_si": _times(DEG, 0.01, -0.005, 0.002)}, scenes.sag, "supply"),
    "magnetic_sensitivity": Shot(
        {"field": tuple(_times(DEG / 3600 * 1e4, *row) for row in ((2, 1, 0), (0, 1, 1), (1, 0, 3)))},
        scenes.turn,
        "angle",
    ),
    "cross_axis_sensitivity": Shot(
        {"cross": _off(5e-3, -2e-3, 3e-3, 1e-3, -4e-3, 2e-3)}, scenes.sweep(10 * G, only_x=True), "input"
    ),
    "vibration_rectification": Shot(
        {"coefficient_per_si": _times(1e-6 / G, 300, -200, 100), "averaging_time_s": 0.3},
        scenes.shaken,
        "time",
    ),
    "size_effect": Shot(
        {"place_x_m": (0.01, 0, 0), "place_y_m": (0, 0.005, 0), "place_z_m": (0.01, 0, 0.02)},
        scenes.spin,
        "rate",
    ),
    "shock_bias_shift": Shot(
        {"shift_si": _times(1e-3 * G, 2, -1, 0.5), "threshold_si": 500.0}, scenes.shock, "time"
    ),
    "bandwidth": Shot({"time_constant_s": 0.02}, scenes.start, "time", "both", (0,)),
    "white_noise": Shot(
        {"density_si_per_sqrt_hz": _times(DEG / 60, 0.2, 0.1, 0.05)}, scenes.night, "time", "allan"
    ),
    "bias_instability": Shot(
        {"standard_deviation_si": _times(DEG / 3600, 20, 10, 5), "correlation_time_s": 30.0},
        scenes.night,
        "time",
        "allan",
    ),
    "flicker_noise": Shot(
        {"coefficient_si": _times(DEG / 3600, 20, 10, 5), "shortest_time_s": 1.0, "longest_time_s": 16384.0},
        scenes.night,
        "time",
        "allan",
    ),
    "rate_random_walk": Shot(
        {"coefficient_si_per_sqrt_s": _times(DEG / 3600, 2, 1, 0.5)}, scenes.night, "time", "allan"
    ),
    "saturation": Shot({"range_si": 200 * DEG}, _RATES, "input", "output", (0,)),
    "quantization": Shot({"quantum_si": 0.05 * DEG}, _SMALL, "input", "output", (0,)),
    "hard_iron": Shot({"field_t": (12e-6, -8e-6, 0.0)}, scenes.compass, "angle", "locus"),
    "soft_iron": Shot(
        {"matrix": ((0.1, 0.08, 0), (0.08, -0.12, 0), (0, 0, 0))}, scenes.compass, "angle", "locus"
    ),
    "current_coupling": Shot({"per_ampere_t": (4e-6, -2e-6, 1e-6)}, scenes.sag, "current"),
    "mains_interference": Shot({"cosine_si": (0.2e-6, 0.1e-6, 0.05e-6)}, scenes.sampled_slowly, "time"),
    "latency": Shot({"latency_s": 0.4}, scenes.drive_round, "time", "both", (0,)),
    "clock_step": Shot({"step_s": 0.4, "at_s": 6.0}, scenes.drive_round, "time", "both", (0,)),
    "antenna_lever_arm": Shot({"arm_m": (1.2, 0.5, 0.8)}, scenes.drive_round, "heading"),
    "multipath": Shot({"standard_deviation_si": (3.0, 2.0, 1.0)}, scenes.night, "time", "allan"),
    "fixed_delay": Shot({"delay_s": 0.02}, scenes.start, "time", "both", (0,)),
    "clock_drift": Shot({"relative_rate": 5e-3}, scenes.swing, "time", "both", (0,)),
    "timestamp_jitter": Shot({"deviation_s": 1e-3}, scenes.swing, "time", "error", (0,)),
    "frame_loss": Shot({"probability": 0.3}, scenes.swing_slowly, "time", "both", (0,)),
    "duplicate_frames": Shot({"probability": 0.3}, scenes.swing_slowly, "time", "both", (0,)),
    "counter_wrap": Shot({"half_span_si": 200 * DEG}, _RATES, "input", "output", (0,)),
    "aliasing": Shot({"cosine_si": _times(DEG, 1, 0.5, 0.2), "frequency_hz": 1010.0}, scenes.start, "time"),
    "wobble": Shot(
        {"cosine_rad": _times(DEG / 3600, 0, 20, 0), "sine_rad": _times(DEG / 3600, 0, 0, 20)},
        scenes.turn,
        "angle",
    ),
    "rate_ripple": Shot({"cosine": 1e-3, "harmonic": 12.0}, scenes.turn, "angle"),
    "encoder_eccentricity": Shot({"cosine_rad": 20 * DEG / 3600}, scenes.turn, "angle", axes=(0,)),
    "remount_misalignment": Shot({"rotation_rad": (1e-3, -5e-4, 2e-3)}, scenes.turn, "angle", sensor="acc"),
    "earth_rate": Shot({"share": 1.0}, scenes.turn, "angle"),
    "lever_arm": Shot({"arm_m": (0.01, 0.0, 0.005)}, scenes.spin, "rate"),
    "motor_field": Shot({"cosine_t": (0, 3e-6, 0), "sine_t": (1e-6, 0, 2e-6)}, scenes.turn, "angle"),
    "chamber_gradient": Shot({"share": (0.05, 0.03, 0.01)}, scenes.soak, "temperature"),
    "chamber_lag": Shot({"time_constant_s": 300.0}, scenes.soak, "time", "both", (0,)),
    "level_drift": Shot({"tilt_rate_rad_s": (5e-7, -2e-7, 0.0)}, scenes.rest, "time", sensor="acc"),
    "non_orthogonality": Shot(
        {"outer_middle_rad": 1e-3, "middle_inner_rad": 5e-4}, scenes.tilting, "middle", sensor="acc"
    ),
    "rate_scale_factor": Shot({"share": 1e-4}, _RATES, "input", axes=(0,)),
    "crank_geometry": Shot({"ratio": 0.2, "radius_m": 0.15}, scenes.crank, "angle", "both", (0,)),
}
"""Word of the catalogue → its shot."""


def picture(kind: type[CatalogueEffect]) -> str:
    """The SVG of one effect."""
    shot = SHOTS[kind.word]
    effect = kind(shot.sensor or kind.sensors[0], **shot.parameters)
    stimulus = shot.scene()
    if isinstance(effect, StochasticEffect) and shot.show == "allan":
        return _allan(effect, stimulus).svg()
    inputs = stimulus.true_input(effect.sensor)
    outputs = effect.apply(inputs, stimulus, np.random.Generator(np.random.SFC64(1)), EffectState())
    return _plot(shot, effect, stimulus, inputs[1:], outputs[1:]).svg()


def caption(kind: type[CatalogueEffect]) -> str:
    """The motion of its picture, in words."""
    return " ".join((SHOTS[kind.word].scene.__doc__ or "").split())


def pictures() -> dict[str, str]:
    """File name → SVG, for every effect."""
    return {f"{kind.word}.svg": picture(kind) for kind in KINDS}


def _plot(
    shot: Shot, effect: CatalogueEffect, stimulus: Stimulus, inputs: FloatArray, outputs: FloatArray
) -> Plot:
    # the first sample is left out: a rate of change is not known there
    label, unit, error_name, error_unit = SCALE[effect.sensor]
    if shot.show == "locus":
        ideal, seen = inputs / unit, outputs / unit
        curves = (
            Curve("true", ideal[:, 0], ideal[:, 1], dashed=True),
            Curve("output", seen[:, 0], seen[:, 1]),
        )
        return Plot("x, µT", "y, µT", curves, square=True)
    x_label, x = _abscissa(shot, effect.sensor, stimulus, inputs)
    x = x[-len(inputs) :]
    names = ("east", "north", "up") if effect.sensor == "gnss" else AXES
    if shot.show == "error":
        error = (outputs - inputs) / error_unit
        curves = tuple(Curve(names[axis], x, error[:, axis]) for axis in shot.axes)
        if isinstance(effect, TimestampJitter):
            bound = np.sqrt(effect.variance(stimulus))[1:, 0] / error_unit
            both = np.concatenate([bound, [np.nan], -bound])
            curves = (*curves, Curve("± σ |u̇|", np.concatenate([x, x[:1], x]), both, dashed=True))
        return Plot(x_label, f"error, {error_name}", curves)
    if shot.show == "output":
        curves = tuple(Curve(f"output {names[axis]}", x, outputs[:, axis] / unit) for axis in shot.axes)
        return Plot(x_label, label, (*curves, Curve("input", x, inputs[:, 0] / unit, dashed=True)))
    (axis,) = shot.axes
    true = Curve("input", x, inputs[:, axis] / unit, dashed=True)
    return Plot(
        x_label,
        label,
        (true, Curve("output", x, outputs[:, axis] / unit, dots=isinstance(effect, StochasticEffect))),
    )


def _abscissa(
    shot: Shot, sensor: SensorName, stimulus: Stimulus, inputs: FloatArray
) -> tuple[str, FloatArray]:
    match shot.over:
        case "time":
            return "time, s", stimulus.time_s
        case "input":
            return f"input: {SCALE[sensor][0]}", inputs[:, 0] / SCALE[sensor][1]
        case "temperature":
            return "temperature, °C", stimulus.temperature_c
        case "supply":
            return "supply, V", stimulus.channel("supply_v")
        case "current":
            return "supply current, A", stimulus.channel("supply_current_a")
        case "rate":
            return "rate about z, °/s", stimulus.channel("rate_rad_s")[:, 2] / DEG
        case "heading":
            dcm = stimulus.channel("dcm_local_from_body")
            return "heading, °", np.unwrap(np.arctan2(dcm[:, 0, 0], dcm[:, 1, 0])) / DEG
        case "middle":
            return "middle angle, °", stimulus.channel("angles_rad")[:, 1] / DEG
        case _:
            return "inner angle, °", stimulus.channel("angles_rad")[:, 2] / DEG


def _allan(effect: StochasticEffect, stimulus: Stimulus) -> Plot:
    period, count = stimulus.sample_period_s, len(stimulus.time_s)
    rng = np.random.Generator(np.random.SFC64(1))
    samples = effect.apply(np.zeros((count, 3)), stimulus, rng, EffectState())[:, 0]
    sums = np.concatenate([[0.0], np.cumsum(samples)])
    spans = np.unique(np.geomspace(1, count // 20, 40).astype(int))
    seen = [np.sqrt(np.mean((sums[2 * m :] - 2 * sums[m:-m] + sums[: -2 * m]) ** 2) / 2.0) / m for m in spans]
    times = spans * period
    unit = DEG / 3600 if effect.sensor == "gyro" else SCALE[effect.sensor][3]
    expected = effect.allan_deviation(times, period)[:, 0] / unit
    name = "°/h" if effect.sensor == "gyro" else SCALE[effect.sensor][2]
    curves = (
        Curve("sampled", times, np.array(seen) / unit, dots=True),
        Curve("theory", times, expected, dashed=True),
    )
    return Plot("averaging time, s", f"Allan deviation, {name}", curves, logarithmic=True)
