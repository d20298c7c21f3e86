"""What the stand does to a unit: four kinds of tests, integrated at ten times the output rate.

Lab axes: x north, y west, z up. The table turns outer about z, middle about y, inner about x:
R_lab_body = Rz(outer) Ry(middle) Rx(inner). Rates in deg/s, specific force in g, field in uT, degC.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Array = NDArray[np.float64]

OVERSAMPLING = 10
FIELD_LAB = np.array([27.0, 1.5, -45.0])
"""North, west, up; the site says north, east, down."""
LATITUDE_DEG = 34.2
EARTH_RATE_DEG_S = 15.041067 / 3600
EARTH_LAB = EARTH_RATE_DEG_S * np.array(
    [np.cos(np.deg2rad(LATITUDE_DEG)), 0.0, np.sin(np.deg2rad(LATITUDE_DEG))]
)
KINDS = ("staircase", "tumble", "static_ramp", "swing")


@dataclass
class Run:
    """One recording's truth at the fine rate: `fine` rows, `rows` after averaging ten by ten."""

    rate_hz: float
    rows: int
    mount: int
    t: Array
    angles: Array
    angle_rates: Array
    w: Array
    dw: Array
    f: Array
    m: Array
    rotation: Array
    temperature: Array
    temperature_rate: Array
    chamber: Array
    supply: Array
    shock_s: float | None

    def averaged(self, fine: Array) -> Array:
        """(fine, …) to (rows, …): the mean over each sample period, centred on its time stamp."""
        return np.einsum("ro...->r...", fine.reshape(self.rows, OVERSAMPLING, *fine.shape[1:])) / OVERSAMPLING


@dataclass
class Excitation:
    """A test: its runs, and where each begins in the stacked output rows."""

    kind: str
    runs: list[Run]
    magnetometer: bool = False
    supply: bool = False

    @property
    def rows(self) -> int:
        """Output rows of all runs."""
        return sum(run.rows for run in self.runs)

    def slices(self) -> list[slice]:
        """Rows of each run in stacked arrays."""
        ends = np.cumsum([run.rows for run in self.runs])
        return [slice(int(end) - run.rows, int(end)) for run, end in zip(self.runs, ends, strict=True)]

    def stacked(self, of_run: Callable[[Run], Array]) -> Array:
        """Averaged down and stacked: `of_run` gives (fine, …) for a run."""
        return np.concatenate([run.averaged(of_run(run)) for run in self.runs])


def lagged(x: Array, time_constant: float, step: float, initial: float) -> Array:
    """First-order lag of piecewise linear x: exact for a ramp between samples (first-order hold)."""
    a = np.exp(-step / time_constant)
    ratio = time_constant / step
    new, old = 1 - ratio * (1 - a), ratio * (1 - a) - a
    driven = np.empty_like(x)
    driven[0] = initial
    driven[1:] = new * x[1:] + old * x[:-1]
    bands = np.ones((2, len(x)))
    bands[1] = -a
    return solve_banded((1, 0), bands, driven, check_finite=False)


def smoothed(x: Array, width: int) -> Array:
    """Moving average over an odd width, twice: corners become parabolas."""
    width |= 1
    half = width // 2
    for _ in range(2):
        total = np.cumsum(np.concatenate([np.full(half + 1, x[0]), x, np.full(half, x[-1])]))
        x = (total[width:] - total[:-width]) / width
    return x


def steps(parts: list[tuple[float, float]], t: Array, smoothing_s: float = 0.5) -> Array:
    """Piecewise constant values (duration, value) on t, with smooth transitions; 0 after the last."""
    ends = np.cumsum([duration for duration, _ in parts])
    values = np.array([value for _, value in parts] + [0.0])
    profile = values[np.searchsorted(ends, t - t[0], side="right")]
    return smoothed(profile, int(smoothing_s / (t[1] - t[0])))


def _turned(angles: Array, rates: Array) -> tuple[Array, Array]:
    """Rotation matrices lab from body (n, 3, 3) and body rates (deg/s) of gimbal angles in rad."""
    co, cm, ci = np.cos(angles).T
    so, sm, si = np.sin(angles).T
    rotation = np.empty((len(angles), 3, 3))
    rotation[:, 0] = np.stack([co * cm, co * sm * si - so * ci, co * sm * ci + so * si], 1)
    rotation[:, 1] = np.stack([so * cm, so * sm * si + co * ci, so * sm * ci - co * si], 1)
    rotation[:, 2] = np.stack([-sm, cm * si, cm * ci], 1)
    o, m, i = rates.T
    return rotation, np.stack([i - o * sm, m * ci + o * cm * si, o * cm * ci - m * si], 1)


def _run(
    rng: np.random.Generator, rate: float, rows: int, mount: int, start_s: float, shock: bool,
    rates_of: Callable[[np.random.Generator, Array], Array],
    chamber_of: Callable[[np.random.Generator, Array], Array],
    initial_angles: Array,
) -> Run:  # fmt: skip
    step = 1 / (rate * OVERSAMPLING)
    t = start_s + (np.arange(rows * OVERSAMPLING) + 0.5) * step
    rates = rates_of(rng, t)
    angles = initial_angles + np.deg2rad(np.cumsum(rates, axis=0) - 0.5 * rates) * step
    rotation, w = _turned(angles, rates)
    f = rotation[:, 2].copy()
    shock_s = None
    if shock:
        shock_s = float(t[0] + rng.uniform(0.4, 0.6) * (t[-1] - t[0]))
        inside = np.clip((t - shock_s) / 0.06, 0, 1)
        f += (np.sin(np.pi * inside) * (inside < 1))[:, None] * rng.uniform(1.5, 3, 3)
    chamber = chamber_of(rng, t)
    tau, heating = rng.uniform(12, 30), rng.uniform(0.5, 2.5)
    own = lagged(chamber, tau, step, chamber[0]) + heating * (1 - np.exp(-t / rng.uniform(40, 120)))
    changes = [
        (float(d), float(v)) for d, v in zip(rng.uniform(15, 60, 60), rng.normal(0, 0.25, 60), strict=True)
    ]
    supply = 5 + rng.normal(0, 0.02) + steps(changes, t, 1.0)
    return Run(
        rate_hz=rate, rows=rows, mount=mount, t=t, angles=angles, angle_rates=rates, w=w,
        dw=np.gradient(w, step, axis=0), f=f, m=np.einsum("nji,j->ni", rotation, FIELD_LAB),
        rotation=rotation, temperature=own, temperature_rate=np.gradient(own, step), chamber=chamber,
        supply=supply, shock_s=shock_s,
    )  # fmt: skip


def _staircase_rates(rng: np.random.Generator, t: Array) -> Array:
    """Three attitudes, each with a staircase; the same cold and hot; slow turning in the ramps; a sweep."""
    total = t[-1] - t[0]
    levels = np.exp(rng.uniform(np.log([8, 40, 110]), np.log([20, 80, 220])))
    part = total * 0.185 / 3
    each = (part - 3) / 6
    outer: list[tuple[float, float]] = []
    middle: list[tuple[float, float]] = []
    inner: list[tuple[float, float]] = []
    turns = [(-90 / 3, 0.0), (90 / 3, 90 / 3), (0.0, -90 / 3)]
    for _ in range(2):
        for turn_middle, turn_inner in turns:
            outer += [(3, 0.0)] + [(each, sign * level) for level in levels for sign in (1, -1)]
            middle += [(3, turn_middle), (part - 3, 0.0)]
            inner += [(3, turn_inner), (part - 3, 0.0)]
        slow = total * 0.235
        for axis, rate in ((outer, rng.uniform(2, 5)), (middle, 0.0), (inner, 0.0)):
            axis += [(slow / 2, rate), (slow / 2, -rate)]
    rates = np.stack([steps(axis, t) for axis in (outer, middle, inner)], 1)
    sweep = _sweep(rng, t, t[0] + 0.85 * total, t[-1] - 1, 0.08, 1.6, rng.uniform(30, 60))
    direction = rng.normal(size=3)
    return rates + sweep[:, None] * direction / np.linalg.norm(direction)


def _sweep(
    rng: np.random.Generator, t: Array, start: float, end: float, low_hz: float, high_hz: float, peak: float
) -> Array:
    """Logarithmic sine sweep of a rate, faded in and out over 2 s."""
    x = np.clip((t - start) / (end - start), 0, 1)
    ratio = np.log(high_hz / low_hz)
    phase = 2 * np.pi * low_hz * (end - start) / ratio * np.expm1(x * ratio)
    fade = np.clip(np.minimum(t - start, end - t) / 2, 0, 1)
    return peak * np.sin(phase + rng.uniform(0, 2 * np.pi)) * (3 * fade**2 - 2 * fade**3)


def _tumble_rates(rng: np.random.Generator, t: Array) -> Array:
    """About thirty positions with rests, then slow turning about two axes."""
    total = t[-1] - t[0]
    columns = []
    for slow in (rng.uniform(8, 30), rng.uniform(6, 15), rng.uniform(8, 25)):
        parts: list[tuple[float, float]] = []
        while sum(duration for duration, _ in parts) < 0.65 * total:
            parts += [(rng.uniform(4, 9), 0.0), (4.0, float(rng.normal(0, 18)))]
        left = (total - sum(duration for duration, _ in parts)) / 4
        parts += [(left, slow), (left, -slow), (left, 1.4 * slow), (left - 3, -1.4 * slow)]
        columns.append(steps(parts, t))
    return np.stack(columns, 1)


def _swing_rates(rng: np.random.Generator, t: Array) -> Array:
    """Swings of middle and inner axes at their own frequencies, sweeps of all three in turn."""
    total = t[-1] - t[0]
    rates = np.zeros((len(t), 3))
    for axis in (1, 2):
        frequency, peak = rng.uniform(0.15, 0.45), rng.uniform(40, 90)
        envelope = np.clip(np.minimum(t - t[0], t[0] + 0.45 * total - t) / 10, 0, 1)
        rates[:, axis] = peak * envelope * np.cos(2 * np.pi * frequency * (t - t[0]) + rng.uniform(0, 6))
    for axis in range(3):
        start = t[0] + (0.48 + 0.17 * axis) * total
        rates[:, axis] += _sweep(rng, t, start, start + 0.165 * total, 0.1, 3.0, rng.uniform(50, 120))
    rates[:, 0] += steps([(0.2 * total, rng.uniform(20, 60)), (0.2 * total, -rng.uniform(20, 60))], t)
    return rates


def _still(rng: np.random.Generator, t: Array) -> Array:
    return np.zeros((len(t), 3))


def _ramps(rng: np.random.Generator, t: Array) -> Array:
    """Cold soak, up to hot, hot soak, down to cold, rest; chamber temperature."""
    cold, hot = rng.uniform(-22, -15), rng.uniform(55, 62)
    corners = np.cumsum([0, 0.185, 0.235, 0.185, 0.235]) + rng.normal(0, 0.008, 5)
    x = (t - t[0]) / (t[-1] - t[0])
    return smoothed(np.interp(x, corners[1:], [cold, hot, hot, cold]), int(8 / (t[1] - t[0])))


def _ramps_from_start(rng: np.random.Generator, t: Array) -> Array:
    """Cold start, up, soak, down, and up again half way; two ramp rates."""
    cold, hot = rng.uniform(-22, -15), rng.uniform(55, 62)
    corners = np.cumsum([0.1, 0.2, 0.12, 0.3, 0.06, 0.15]) + rng.normal(0, 0.008, 6)
    x = (t - t[0]) / (t[-1] - t[0])
    return smoothed(np.interp(x, corners, [cold, hot, hot, cold, cold, 20]), int(8 / (t[1] - t[0])))


def _room(rng: np.random.Generator, t: Array) -> Array:
    period = rng.uniform(300, 900)
    return rng.uniform(21, 25) + rng.uniform(0.3, 1.2) * np.sin(2 * np.pi * t / period + rng.uniform(0, 6))


_TESTS = {
    "staircase": (25.0, 600.0, _staircase_rates, _ramps),
    "tumble": (25.0, 480.0, _tumble_rates, _room),
    "static_ramp": (20.0, 780.0, _still, _ramps_from_start),
    "swing": (50.0, 300.0, _swing_rates, _room),
}


def excitation(
    kind: str, key: tuple[int, ...], carrier: tuple[float, int] | None = None, stretch: float = 1.0
) -> Excitation:
    """An instance of a kind of test, reproducible by its key: one to four runs, one or two mounts.

    Args:
        kind: one of KINDS.
        key: whole numbers.
        carrier: output rate (Hz) and rows of each of two runs, where a real noise record sets them.
        stretch: of all durations.
    """
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((*key, KINDS.index(kind)))))
    base_rate, base_s, rates_of, chamber_of = _TESTS[kind]
    count = int(rng.choice([1, 2, 3, 4], p=[0.1, 0.7, 0.13, 0.07]))
    rate = float(base_rate * rng.uniform(0.93, 1.1))
    duration = stretch * base_s * rng.uniform(0.9, 1.05) * {1: 1.2, 2: 1.0, 3: 0.72, 4: 0.55}[count]
    rows = int(duration * rate)
    if carrier is not None:
        count, (rate, rows) = 2, carrier
    two_mounts = count > 1 and rng.random() < 0.5
    initial = rng.uniform(-np.pi, np.pi, 3) if kind != "staircase" else np.zeros(3)
    runs = []
    for number in range(count):
        cold_start = kind in ("staircase", "static_ramp")
        start = rng.uniform(0.5, 4) if cold_start else rng.uniform(20, 400)
        angles = initial if kind != "static_ramp" else rng.uniform(-np.pi, np.pi, 3)
        mount = 2 if two_mounts and number >= (count + 1) // 2 else 1
        runs.append(
            _run(rng, rate, rows, mount, start, kind == "swing", rates_of, chamber_of, angles)
        )  # fmt: skip
    magnetometer = carrier is None and rng.random() < (0.7 if kind in ("tumble", "swing") else 0.3)
    return Excitation(kind, runs, magnetometer, bool(carrier is None and rng.random() < 0.6))
