"""Shapes of the catalogue's deterministic effects, written from their names and textbook physics alone.

A shape is a list of blocks; a block maps channels to columns (rows, k) that share k coefficients. An
effect of a triad has one block for each axis and acts on one axis or on all three; a joint effect
(delay, lever arm, wobble) has a single block. `phi` is what enters non-linearly.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.excitations import EARTH_LAB, Excitation, Run

Array = NDArray[np.float64]
Block = dict[str, Array]

AXES = "xyz"
TRIADS = {"gyro": ("gyro_x", "gyro_y", "gyro_z"), "acc": ("acc_x", "acc_y", "acc_z"),
          "mag": ("mag_x", "mag_y", "mag_z")}  # fmt: skip
CHANNELS = tuple(channel for triad in TRIADS.values() for channel in triad)
STANDARD_GRAVITY = 9.80665
REFERENCE_C = 25.0


@dataclass(frozen=True)
class Shape:
    """An effect: how its columns come from the truth, and how large its coefficients may be.

    Attributes:
        blocks: columns for an excitation and a phi.
        limit: largest plausible norm of the coefficients, in the columns' own units; an excitation that
            needs more for the wanted signal-to-noise ratio does not show the effect.
        grid: values of phi over which the oracle integrates; `range` is where the truth is drawn.
        whole: acts on all axes at once, never on one alone.
        positive: the (single) coefficient cannot be negative.
    """

    name: str
    blocks: Callable[[Excitation, float], list[Block]]
    limit: float
    grid: tuple[float, ...] = (0.0,)
    range: tuple[float, float] | None = None
    whole: bool = False
    positive: bool = False

    def drawn_phi(self, rng: np.random.Generator) -> float:
        """Log-uniform in the range, off every grid; a whole number where the grid is of whole numbers."""
        if self.range is None:
            return self.grid[int(rng.integers(len(self.grid)))]
        return float(np.exp(rng.uniform(*np.log(self.range))))


def played(x: Array, half_width: float) -> Array:
    """Play operator with the state following x at a distance of at most half_width, relaxed at first.

    Between two turning points the state has a closed form, so that only those are walked through.
    """
    rising = np.diff(x) > 0
    turns = np.flatnonzero(rising[1:] != rising[:-1]) + 1
    state, result = x[0], np.empty_like(x)
    for start, end in zip([0, *turns], [*turns + 1, len(x)], strict=True):
        part = x[start:end]
        up = part[-1] > part[0]
        follow = np.maximum(state, part - half_width) if up else np.minimum(state, part + half_width)
        result[start:end] = follow
        state = follow[-1]
    return result


def _per_axis(
    triad: str, columns: Callable[[Run, float], Array]
) -> Callable[[Excitation, float], list[Block]]:
    """Blocks of one channel each, from a function that gives (fine, 3) or (fine, 3, k)."""

    def blocks(excitation: Excitation, phi: float) -> list[Block]:
        stacked = excitation.stacked(lambda run: columns(run, phi))
        stacked = stacked if stacked.ndim == 3 else stacked[:, :, None]
        return [{channel: stacked[:, axis]} for axis, channel in enumerate(TRIADS[triad])]

    return blocks


def _joint(parts: dict[str, Callable[[Run, float], Array]]) -> Callable[[Excitation, float], list[Block]]:
    """One block over whole triads, from functions that give (fine, 3, k)."""

    def blocks(excitation: Excitation, phi: float) -> list[Block]:
        block: Block = {}
        for triad, columns in parts.items():
            stacked = excitation.stacked(lambda run, columns=columns: columns(run, phi))
            stacked = stacked if stacked.ndim == 3 else stacked[:, :, None]
            block |= {channel: stacked[:, axis] for axis, channel in enumerate(TRIADS[triad])}
        return [block]

    return blocks


def _every_axis(scalar: Array) -> Array:
    return np.repeat(scalar[:, None], 3, axis=1)


def _all_columns(vector: Array) -> Array:
    """(fine, k) as columns of each of three axes."""
    return np.repeat(vector[:, None, :], 3, axis=1)


def _others(vector: Array) -> Array:
    """(fine, 3, 2): for each axis the two other components."""
    return np.stack([vector[:, [1, 2]], vector[:, [0, 2]], vector[:, [0, 1]]], axis=1)


def _warmer(run: Run) -> Array:
    return (run.temperature - REFERENCE_C)[:, None]


def _temperature_polynomial(run: Run, phi: float) -> Array:
    x = run.temperature - REFERENCE_C
    return _all_columns(np.stack([x, x**2 / 40], 1))


def _hysteresis_of(x: Array, half_width: float) -> Array:
    return (x - played(x, half_width)) / half_width


def _thermal_hysteresis(run: Run, phi: float) -> Array:
    return _every_axis(_hysteresis_of(run.temperature, phi))


def _rate_hysteresis(run: Run, phi: float) -> Array:
    return np.stack([_hysteresis_of(run.w[:, axis], phi) for axis in range(3)], axis=1)


def _warm_up(run: Run, phi: float) -> Array:
    return _every_axis(np.exp(-run.t / phi))


def _delay_of(signal: Callable[[Run], Array]) -> Callable[[Run, float], Array]:
    return lambda run, phi: -np.gradient(signal(run), run.t[1] - run.t[0], axis=0)


def _drift_of(signal: Callable[[Run], Array]) -> Callable[[Run, float], Array]:
    delay = _delay_of(signal)
    return lambda run, phi: delay(run, phi) * run.t[:, None]


def _size(run: Run) -> Array:
    """(fine, 3, 3): specific force (g) of axis i per metre of its own offset from the centre."""
    w, dw = np.deg2rad(run.w), np.deg2rad(run.dw)
    columns = []
    for unit in np.eye(3):
        columns.append(np.cross(w, np.cross(w, unit)) + np.cross(dw, unit))
    return np.stack(columns, axis=2) / STANDARD_GRAVITY


def _after_shock(run: Run, phi: float) -> Array:
    since = np.zeros_like(run.t) if run.shock_s is None else (run.t > run.shock_s + 0.03).astype(float)
    return _every_axis(since)


def _attitude_error(of_run: Callable[[Run], Array], *, mag: bool) -> dict[str, Callable[[Run, float], Array]]:
    """Columns of a small rotation (fine, 3, k) of the true against the reported attitude, body axes, rad.

    R_true = R (I + [e x]): rate e' + w x e (deg/s), a lab vector v is seen as v - e x v.
    """

    def gyro(run: Run, phi: float) -> Array:
        e = of_run(run)
        rate = np.rad2deg(np.gradient(e, run.t[1] - run.t[0], axis=0))
        return rate + np.cross(run.w[:, :, None], e, axis=1)

    parts = {"gyro": gyro, "acc": lambda run, phi: -np.cross(of_run(run), run.f[:, :, None], axis=1)}
    if mag:
        parts["mag"] = lambda run, phi: -np.cross(of_run(run), run.m[:, :, None], axis=1)
    return parts


def _in_body(run: Run, lab: Array) -> Array:
    """(fine, 3, k) lab to body."""
    return np.einsum("nji,njk->nik", run.rotation, lab)


def _wobble(run: Run) -> Array:
    """The outer axis tilts once per turn towards fixed directions of the room."""
    c, s = np.cos(run.angles[:, 0]), np.sin(run.angles[:, 0])
    lab = np.zeros((len(c), 3, 4))
    lab[:, 0, 0], lab[:, 0, 1], lab[:, 1, 2], lab[:, 1, 3] = c, s, c, s
    return _in_body(run, lab)


def _eccentricity(run: Run) -> Array:
    lab = np.zeros((len(run.t), 3, 2))
    lab[:, 2, 0], lab[:, 2, 1] = np.cos(run.angles[:, 0]) - 1, np.sin(run.angles[:, 0])
    return _in_body(run, lab)


def _non_orthogonality(run: Run) -> Array:
    """Outer against middle axis, middle against inner axis."""
    (cm, sm), (ci, si) = ((np.cos(run.angles[:, k]), np.sin(run.angles[:, k])) for k in (1, 2))
    zero = np.zeros_like(cm)
    first = np.stack([cm, sm * si, sm * ci], 1)
    second = np.stack([zero, si, ci], 1)
    return np.stack([first, second], axis=2)


def _level_drift(run: Run) -> Array:
    lab = np.zeros((len(run.t), 3, 2))
    lab[:, 0, 0] = lab[:, 1, 1] = (run.t - run.t[0]) / 600
    return _in_body(run, lab)


def _rate_ripple(run: Run, phi: float) -> Array:
    angle = phi * run.angles[:, 0]
    along = run.rotation[:, 2] * run.angle_rates[:, :1]
    return np.stack([along * np.cos(angle)[:, None], along * np.sin(angle)[:, None]], axis=2)


def _spaced(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(float(x) for x in np.geomspace(low, high, count))


_HYSTERESIS = {"grid": _spaced(2, 14, 10), "range": (2.0, 14.0)}
_WARM_UP = {"grid": _spaced(25, 450, 10), "range": (30.0, 400.0)}

_SHAPES = [
    Shape("gyro.bias_temperature", _per_axis("gyro", _temperature_polynomial), 0.02),
    Shape("gyro.scale_factor_temperature", _per_axis("gyro", lambda r, p: r.w * _warmer(r)), 3e-3),
    Shape("gyro.scale_factor_asymmetry", _per_axis("gyro", lambda r, p: np.abs(r.w)), 1e-2),
    Shape("gyro.scale_factor_nonlinearity", _per_axis("gyro", lambda r, p: r.w**3 / 200**2), 1e-2),
    Shape("gyro.even_nonlinearity", _per_axis("gyro", lambda r, p: r.w**2 / 200), 1e-2),
    Shape("gyro.g_sensitivity", _per_axis("gyro", lambda r, p: _all_columns(r.f)), 0.2),
    Shape("gyro.g2_sensitivity", _per_axis("gyro", lambda r, p: _all_columns(r.f**2)), 0.05),
    Shape("gyro.thermal_hysteresis", _per_axis("gyro", _thermal_hysteresis), 1.0, **_HYSTERESIS),
    Shape("gyro.rate_hysteresis", _per_axis("gyro", _rate_hysteresis), 0.3,
          grid=_spaced(4, 60, 8), range=(5.0, 50.0)),
    Shape("gyro.temperature_rate", _per_axis("gyro", lambda r, p: _every_axis(60 * r.temperature_rate)), 0.1),
    Shape("gyro.warm_up", _per_axis("gyro", _warm_up), 1.0, **_WARM_UP),
    Shape("gyro.misalignment_temperature",
          _per_axis("gyro", lambda r, p: _others(r.w) * _warmer(r)[:, :, None]), 1e-3),
    Shape("gyro.bandwidth", _joint({"gyro": _delay_of(lambda r: r.w)}), 0.1, whole=True, positive=True),
    Shape("gyro.supply_sensitivity", _per_axis("gyro", lambda r, p: _every_axis(r.supply - 5)), 0.1),
    Shape("gyro.magnetic_sensitivity", _per_axis("gyro", lambda r, p: _all_columns(r.m)), 0.01),
    Shape("acc.bias_temperature", _per_axis("acc", _temperature_polynomial), 1e-2),
    Shape("acc.scale_factor_temperature", _per_axis("acc", lambda r, p: r.f * _warmer(r)), 2e-3),
    Shape("acc.scale_factor_asymmetry", _per_axis("acc", lambda r, p: np.abs(r.f)), 1e-2),
    Shape("acc.quadratic_nonlinearity", _per_axis("acc", lambda r, p: r.f**2), 5e-3),
    Shape("acc.odd_quadratic_nonlinearity", _per_axis("acc", lambda r, p: r.f * np.abs(r.f)), 5e-3),
    Shape("acc.cubic_nonlinearity", _per_axis("acc", lambda r, p: r.f**3), 5e-3),
    Shape("acc.size_effect", _per_axis("acc", lambda r, p: _size(r)), 0.2, whole=True),
    Shape("acc.shock_bias_shift", _per_axis("acc", _after_shock), 0.05),
    Shape("acc.warm_up", _per_axis("acc", _warm_up), 0.05, **_WARM_UP),
    Shape("acc.thermal_hysteresis", _per_axis("acc", _thermal_hysteresis), 0.05, **_HYSTERESIS),
    Shape("mag.scale_factor_temperature", _per_axis("mag", lambda r, p: r.m * _warmer(r)), 0.1),
    Shape("link.fixed_delay",
          _joint({"gyro": _delay_of(lambda r: r.w), "acc": _delay_of(lambda r: r.f),
                  "mag": _delay_of(lambda r: r.m)}),
          0.2, positive=True),
    Shape("link.clock_drift",
          _joint({"gyro": _drift_of(lambda r: r.w), "acc": _drift_of(lambda r: r.f),
                  "mag": _drift_of(lambda r: r.m)}),
          1e-3),
    Shape("stand.wobble", _joint(_attitude_error(_wobble, mag=True)), 3e-3),
    Shape("stand.rate_ripple", _joint({"gyro": _rate_ripple}), 1e-2,
          grid=tuple(float(n) for n in range(2, 13))),
    Shape("stand.encoder_eccentricity", _joint(_attitude_error(_eccentricity, mag=True)), 3e-3),
    Shape("stand.non_orthogonality", _joint(_attitude_error(_non_orthogonality, mag=True)), 1e-2),
    Shape("stand.lever_arm", _joint({"acc": lambda r, p: _size(r)}), 0.2),
    Shape("stand.level_drift", _joint(_attitude_error(_level_drift, mag=True)), 1e-2),
    Shape("stand.earth_rate",
          _joint({"gyro": lambda r, p: np.einsum("nji,j->ni", r.rotation, EARTH_LAB)}),
          np.inf, positive=True),
]  # fmt: skip

SHAPES: dict[str, Shape] = {shape.name: shape for shape in _SHAPES}


# What an amplitude cannot simply scale: columns of a known size, for a threshold in deg/s.


def dead_band(excitation: Excitation, threshold: float) -> list[Block]:
    """What is missing where a gyro shows nothing below a threshold."""
    return _per_axis("gyro", lambda run, p: -run.w * (np.abs(run.w) < p))(excitation, threshold)


def saturation(excitation: Excitation, level: float) -> list[Block]:
    """What is missing where a gyro stops at a level below its stated range."""
    return _per_axis("gyro", lambda run, p: np.clip(run.w, -p, p) - run.w)(excitation, level)


THRESHOLDS: dict[str, tuple[Callable[[Excitation, float], list[Block]], tuple[float, ...]]] = {
    "gyro.dead_band": (dead_band, _spaced(0.01, 10, 14)),
    "gyro.saturation": (saturation, tuple(1 - x for x in _spaced(5e-4, 0.6, 16))),
}
"""Dead band: thresholds in deg/s. Saturation: fractions of each axis' largest rate."""
