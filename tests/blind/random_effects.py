"""Effects that are noise, lines or frames: their amplitudes, their spectra, what they do to a recording."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize

from tests.blind.effect_shapes import TRIADS, Block
from tests.blind.excitations import Excitation
from tests.blind.noise import ChannelNoise
from tests.blind.units import Frames

Array = NDArray[np.float64]

STOCHASTIC = {
    "gyro.angle_random_walk": ("gyro", "white"),
    "gyro.bias_instability": ("gyro", "slow"),
    "gyro.rate_random_walk": ("gyro", "walk"),
    "acc.velocity_random_walk": ("acc", "white"),
    "acc.bias_instability": ("acc", "slow"),
    "mag.white_noise": ("mag", "white"),
}
LINES = ("link.aliasing", "mag.mains_interference")
DISCRETE = (
    *("link.timestamp_jitter", "link.frame_loss", "link.duplicate_frames", "link.counter_wrap"),
    *("gyro.quantization", "acc.quantization"),
)
MAX_FACTOR = 40.0
BINS = 120


def louder(noise: ChannelNoise, part: str, amount: float) -> ChannelNoise:
    """A channel's noise with one part raised: white and slow by a factor, walk by `amount` whites."""
    if part == "white":
        return replace(noise, white=noise.white * amount)
    if part == "slow":
        return replace(noise, terms=tuple((sigma * amount, tau) for sigma, tau in noise.terms))
    return replace(noise, random_walk=noise.white * amount)


def frequency_bins(rows: list[int]) -> tuple[Array, Array]:
    """Log-spaced angular frequencies and how many Fourier frequencies of all runs each stands for."""
    edges = np.geomspace(2 * np.pi / max(rows), np.pi, BINS + 1)
    counts = np.zeros(BINS)
    for n in rows:
        own = 2 * np.pi * np.arange(1, n // 2) / n
        counts += np.histogram(own, edges)[0]
    return np.sqrt(edges[1:] * edges[:-1]), counts


def stochastic_signal_to_noise(
    noise: ChannelNoise, spreads: tuple[float, float], part: str, amount: float, rows: list[int]
) -> float:
    """d of louder noise: root of twice the expected log likelihood ratio, the unit's spread allowed for.

    The best rival is a unit with the believed kinds of noise at other levels, each deviation of its
    logarithm paid for by the log-normal prior. By Whittle's likelihood.
    """
    angular, counts = frequency_bins(rows)
    true = louder(noise, part, amount).spectrum(angular)
    white = np.full_like(angular, noise.white**2)
    slow = noise.spectrum(angular) - white

    def cost(z: Array) -> float:
        ratio = true / (white * np.exp(2 * spreads[0] * z[0]) + slow * np.exp(2 * spreads[1] * z[1]))
        return float(z @ z + 2 * (counts @ (ratio - 1 - np.log(ratio))))

    starts = ([0.0, 0.0], [np.log(true[-1] / white[-1]) / 2 / spreads[0], 0.5])
    return float(
        np.sqrt(min(minimize(cost, s, method="Nelder-Mead", options={"xatol": 1e-4}).fun for s in starts))
    )


def amount_for(
    noise: ChannelNoise, spreads: tuple[float, float], part: str, d: float, rows: list[int]
) -> float | None:
    """How much louder gives d; None where MAX_FACTOR is not enough."""
    low, high = (1e-5, 0.3) if part == "walk" else (1.0001, MAX_FACTOR)

    def excess(log_amount: float) -> float:
        return stochastic_signal_to_noise(noise, spreads, part, float(np.exp(log_amount)), rows) - d

    if excess(np.log(high)) < 0:
        return None
    return float(np.exp(brentq(excess, np.log(low), np.log(high), xtol=1e-3)))


def line_signal(
    rng: np.random.Generator, excitation: Excitation, name: str
) -> tuple[dict[str, Array], float]:
    """A sine sampled where it is too fast for the rate; (unscaled signal, its true frequency in Hz)."""
    rate = excitation.runs[0].rate_hz
    channels = TRIADS["mag" if name == "mag.mains_interference" else "gyro"]
    frequency = 50 + rng.uniform(-0.05, 0.05)
    if name == "link.aliasing":
        frequency = rate * rng.uniform(0.55, 3)
        while not 0.05 < abs(frequency / rate - round(frequency / rate)) < 0.48:
            frequency = rate * rng.uniform(0.55, 3)
    direction = rng.normal(size=3)
    times = [run.averaged(run.t) for run in excitation.runs]
    phases = rng.uniform(0, 2 * np.pi, len(times))
    wave = np.concatenate([np.sin(2 * np.pi * frequency * t + p) for t, p in zip(times, phases, strict=True)])
    return {channel: direction[axis] * wave for axis, channel in enumerate(channels)}, float(frequency)


def _jittered(rng: np.random.Generator, frames: Frames, noise: dict[str, ChannelNoise]) -> None:
    t = frames.dut["t"]
    step = t[1] - t[0]
    frames.dut["t"] = t + np.clip(rng.normal(0, 0.08 * step, len(t)), -0.45 * step, 0.45 * step)


def _with_losses(rng: np.random.Generator, frames: Frames, noise: dict[str, ChannelNoise]) -> None:
    lost = rng.random(len(frames.dut["t"])) < np.exp(rng.uniform(np.log(0.002), np.log(0.02)))
    frames.dut = {name: column[~lost] for name, column in frames.dut.items()}


def _with_duplicates(rng: np.random.Generator, frames: Frames, noise: dict[str, ChannelNoise]) -> None:
    twice = rng.random(len(frames.dut["t"])) < np.exp(rng.uniform(np.log(0.002), np.log(0.02)))
    frames.dut = {name: np.repeat(column, 1 + twice) for name, column in frames.dut.items()}


def _wrapped(rng: np.random.Generator, frames: Frames, noise: dict[str, ChannelNoise]) -> None:
    """Two's complement words that hold seven tenths of what the widest gyro has to say, to one digit."""
    widest = max(TRIADS["gyro"], key=lambda channel: float(np.abs(frames.dut[channel]).max()))
    half_span = float(f"{0.7 * float(np.abs(frames.dut[widest]).max()):.0e}")
    frames.dut[widest] = (frames.dut[widest] + half_span) % (2 * half_span) - half_span


def _coarse(triad: str) -> Callable[[np.random.Generator, Frames, dict[str, ChannelNoise]], None]:
    def apply(rng: np.random.Generator, frames: Frames, noise: dict[str, ChannelNoise]) -> None:
        for channel in TRIADS[triad]:
            quantum = 2.2 * noise[channel].white
            frames.dut[channel] = np.round(frames.dut[channel] / quantum) * quantum

    return apply


DISCRETE_CHANGES: dict[str, Callable[[np.random.Generator, Frames, dict[str, ChannelNoise]], None]] = {
    "link.timestamp_jitter": _jittered,
    "link.frame_loss": _with_losses,
    "link.duplicate_frames": _with_duplicates,
    "link.counter_wrap": _wrapped,
    "gyro.quantization": _coarse("gyro"),
    "acc.quantization": _coarse("acc"),
}
"""What each does to one run's frames. They are seen in single rows, so the ladder of d does not apply."""


# Out of the catalogue: unscaled signals that no name of the contract covers.


def _telegraph(rng: np.random.Generator, excitation: Excitation) -> Block:
    """Bias that jumps between two levels at random times (random telegraph noise)."""
    parts = []
    for run in excitation.runs:
        jumps = np.cumsum(rng.exponential(rng.uniform(15, 50), 200))
        t = run.averaged(run.t)
        parts.append(np.searchsorted(jumps, t - t[0]) % 2 - 0.5)
    return _on_one(rng, "gyro", np.concatenate(parts))


def _bump(rng: np.random.Generator, excitation: Excitation) -> Block:
    """Bias that comes and goes about one moment of the test, not monotonic in anything recorded."""
    at, width = rng.uniform(0.25, 0.75), rng.uniform(0.04, 0.1)

    def of_run(run) -> Array:
        x = np.linspace(0, 1, len(run.t))
        return np.exp(-0.5 * ((x - at) / width) ** 2) - 0.8 * np.exp(-0.5 * ((x - at - 0.2) / width) ** 2)

    return _on_one(rng, str(rng.choice(["gyro", "acc"])), excitation.stacked(of_run))


def _one_sided_clipping(rng: np.random.Generator, excitation: Excitation) -> Block:
    """A gyro that stops at a level on one side only."""
    axis = int(rng.integers(3))
    level = rng.uniform(0.75, 0.97) * max(float(run.w[:, axis].max()) for run in excitation.runs)
    return {
        TRIADS["gyro"][axis]: excitation.stacked(lambda r: np.minimum(r.w[:, axis], level) - r.w[:, axis])
    }


def _held(rng: np.random.Generator, excitation: Excitation) -> Block:
    """At random times the last value is repeated for a while, though frames and counter go on."""
    axis = int(rng.integers(3))
    w = excitation.stacked(lambda run: run.w[:, axis])
    held = w.copy()
    for start in rng.integers(1, len(w) - 60, 25):
        held[start : start + int(rng.integers(3, 40))] = w[start - 1]
    return {TRIADS["gyro"][axis]: held - w}


def _harmonic_mix(rng: np.random.Generator, excitation: Excitation) -> Block:
    """A bias of the gyro with the angle of the inner axis, at orders that no gear or bearing has."""
    order = rng.uniform(2.2, 5.8, 3)
    phase = rng.uniform(0, 6, 3)
    wave = excitation.stacked(lambda r: np.sin(r.angles[:, 2:] * order + phase).sum(axis=1))
    return _on_one(rng, "gyro", wave)


def _humid(rng: np.random.Generator, excitation: Excitation) -> Block:
    """A drift with overshoot since power-on: a second-order step response."""
    period, damping = rng.uniform(80, 200), rng.uniform(0.1, 0.3)
    natural = 2 * np.pi / period

    def of_run(run) -> Array:
        return np.exp(-damping * natural * run.t) * np.cos(natural * np.sqrt(1 - damping**2) * run.t)

    return _on_one(rng, "gyro", excitation.stacked(of_run))


def _rate_times_force(rng: np.random.Generator, excitation: Excitation) -> Block:
    """A gyro scale factor that depends on the specific force across."""
    axis = int(rng.integers(3))
    return {TRIADS["gyro"][axis]: excitation.stacked(lambda r: r.w[:, axis] * r.f[:, (axis + 1) % 3])}


def _on_one(rng: np.random.Generator, triad: str, wave: Array) -> Block:
    return {TRIADS[triad][int(rng.integers(3))]: wave}


OUT_OF_CATALOGUE: dict[str, Callable[[np.random.Generator, Excitation], Block]] = {
    "telegraph_bias": _telegraph,
    "bump_in_time": _bump,
    "one_sided_clipping": _one_sided_clipping,
    "held_values": _held,
    "harmonic_mix": _harmonic_mix,
    "second_order_drift": _humid,
    "rate_times_force": _rate_times_force,
}


def _wrong_channel(
    target: str, wave: Callable[..., Array]
) -> Callable[[np.random.Generator, Excitation], Block]:
    return lambda rng, excitation: _on_one(rng, target, excitation.stacked(wave))


DECOYS: dict[str, Callable[[np.random.Generator, Excitation], Block]] = {
    "acc_follows_rate": _wrong_channel("acc", lambda run: np.abs(run.w[:, 0])),
    "mag_follows_supply": _wrong_channel("mag", lambda run: run.supply - 5),
    "acc_follows_temperature_rate": _wrong_channel("acc", lambda run: run.temperature_rate),
    "mag_follows_temperature_rate": _wrong_channel("mag", lambda run: run.temperature_rate),
    "mag_follows_force": _wrong_channel("mag", lambda run: run.f[:, 0]),
}
"""Shapes of the catalogue on channels where the catalogue has no such effect."""
STAND_DECOYS = (
    "stand.rate_ripple",
    "stand.wobble",
    "stand.lever_arm",
    "stand.earth_rate",
    "stand.non_orthogonality",
)
"""Faults of the stand that look like a unit's."""
