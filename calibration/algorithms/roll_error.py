"""Roll from the magnetometer held against a reference: its error, and the latency of a fast spin.

A constant latency tau turns the roll back by omega tau: 5.4 deg for each millisecond at 15 rev/s. So does
a rotation of the mounting. One spin rate cannot tell the two; rates of different size, or both ways, can:

    phase(omega) = mounting - omega tau

A skew between the two channels' samples looks like a non-orthogonality of omega skew, 0.54 deg for 100 us
at 15 rev/s: calibrate at one rate and it is hidden, see `nonorthogonality_of_skew_rad`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.allan_variance import FloatArray
from protocol.errors import CalibrationError, Fault

BLOCKS = 32
MIN_BLOCK = 4
DRIFT_ROUNDS = 4
MAX_DRIFT = 5e-3
"""Of the clocks against each other: a hundred times a crystal's; looked for before phases are unwrapped."""
COARSE_SAMPLES = 2000
MIN_RATE_SPREAD = 0.2
"""Spin rates closer than this part of the largest tell latency from mounting too badly."""


@dataclass(frozen=True)
class RollError:
    """Roll less its reference, rad.

    Attributes:
        mean, standard_deviation, largest: of the error wrapped to -pi … pi.
        mean_standard_uncertainty: from the scatter of block means, so that a slow error counts fully.
        once_per_turn: amplitude at the roll's own frequency: a zero that is wrong.
        twice_per_turn: amplitude at twice that: sensitivity ratio or orthogonality that is wrong.
    """

    mean: float
    mean_standard_uncertainty: float
    standard_deviation: float
    largest: float
    once_per_turn: float
    twice_per_turn: float


@dataclass(frozen=True)
class Spin:
    """One steady spin.

    Attributes:
        rate_rad_s: signed spin rate, rad/s.
        roll_rad: from the magnetometer, shape (n,).
        reference_rad: the stand's angle at the same instants of the stand's clock, shape (n,).
        time_s: since the trigger that joined the clocks, shape (n,); None: they are one clock.
    """

    rate_rad_s: float
    roll_rad: FloatArray
    reference_rad: FloatArray
    time_s: FloatArray | None = None


@dataclass(frozen=True)
class RollLatency:
    """Latency and mounting angle.

    Attributes:
        latency_s: tau; the roll is late by it.
        mounting_rad: rotation of the magnetometer's x from the reference's zero.
        covariance: of (latency, mounting), shape (2, 2).
        residual_rad: of each spin's phase from the line, shape (k,).
        clock_drift: of the unit's clock against the stand's, relative, with its standard uncertainty;
            None: not asked for.
    """

    latency_s: float
    mounting_rad: float
    covariance: FloatArray
    residual_rad: FloatArray
    clock_drift: tuple[float, float] | None = None

    @property
    def latency_standard_uncertainty_s(self) -> float:
        """u(tau), s."""
        return float(np.sqrt(self.covariance[0, 0]))


def roll_error(roll_rad: FloatArray, reference_rad: FloatArray) -> RollError:
    """What remains of the roll's error.

    Args:
        roll_rad, reference_rad: shape (n,), at the same instants; whole turns, for the harmonics.

    Raises:
        CalibrationError: missing or too few samples.
    """
    roll, reference = np.asarray(roll_rad, dtype=np.float64), np.asarray(reference_rad, dtype=np.float64)
    if roll.shape != reference.shape or roll.ndim != 1 or len(roll) < BLOCKS * MIN_BLOCK:
        raise _refused(f"A roll error needs {BLOCKS * MIN_BLOCK} samples of both angles.", "record longer")
    if not (np.isfinite(roll).all() and np.isfinite(reference).all()):
        raise _refused("Angles are missing (NaN).", "leave them out")
    turned = np.exp(1j * (roll - reference))
    mean = float(np.angle(turned.mean()))
    error = np.angle(turned * np.exp(-1j * mean))
    mean += float(error.mean())  # the circular mean is not yet the mean
    error = error - error.mean()
    blocks = error[: len(error) // BLOCKS * BLOCKS].reshape(BLOCKS, -1).mean(axis=1)
    harmonics = [float(2.0 * np.abs((error * np.exp(-1j * k * reference)).mean())) for k in (1, 2)]
    return RollError(
        mean,
        max(float(blocks.std(ddof=1)), float(error.std(ddof=1)) / np.sqrt(len(error) / BLOCKS))
        / np.sqrt(BLOCKS),
        float(error.std(ddof=1)),
        float(np.abs(error + mean).max()),
        harmonics[0],
        harmonics[1],
    )


def roll_latency(spins: Sequence[Spin]) -> RollLatency:
    """Latency by phase from spins at two or more rates (both ways at 15 rev/s: +-94.25 rad/s).

    Where the spins have times, a drift of the clocks is fitted too: 8 ppm are 0.2 ms after 20 s, and would
    pass for latency; phase = mounting - omega (tau + drift t).

    Phases are taken between -pi and pi: mounting and latency together must stay below half a turn
    (33 ms at 15 rev/s).

    Raises:
        CalibrationError: rates that cannot tell latency from mounting.
    """
    rates = np.array([spin.rate_rad_s for spin in spins], dtype=np.float64)
    if len(rates) < 2 or float(np.ptp(rates)) < MIN_RATE_SPREAD * float(np.abs(rates).max()):
        raise _refused(
            "Spins at one rate cannot tell a latency from a rotation of the mounting.",
            "spin the other way round too",
        )
    if all(spin.time_s is not None for spin in spins):
        return _with_drift(spins)
    errors = [roll_error(spin.roll_rad, spin.reference_rad) for spin in spins]
    phases = np.array([error.mean for error in errors])
    uncertainties = np.array([error.mean_standard_uncertainty for error in errors])
    weights = 1.0 / np.maximum(uncertainties, 1e-15)
    design = np.column_stack([-rates, np.ones(len(rates))])
    weighted = design * weights[:, None]
    solution, *_ = np.linalg.lstsq(weighted, phases * weights, rcond=None)
    covariance = np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)
    return RollLatency(float(solution[0]), float(solution[1]), covariance, phases - design @ solution)


def _with_drift(spins: Sequence[Spin]) -> RollLatency:
    """By the means of blocks of each spin; their scatter about the fit is that spin's."""
    coarse = _coarse_drift(spins)
    rows: list[FloatArray] = []
    phases: list[FloatArray] = []
    for spin in spins:
        assert spin.time_s is not None
        roll = spin.roll_rad + spin.rate_rad_s * coarse * spin.time_s
        error = roll_error(roll, spin.reference_rad)
        rest = np.angle(np.exp(1j * (roll - spin.reference_rad - error.mean)))
        whole = len(rest) // BLOCKS * BLOCKS
        times = np.asarray(spin.time_s, dtype=np.float64)[:whole].reshape(BLOCKS, -1).mean(axis=1)
        phases.append(error.mean + rest[:whole].reshape(BLOCKS, -1).mean(axis=1))
        rate = np.full(BLOCKS, -spin.rate_rad_s)
        rows.append(np.column_stack([rate, np.ones(BLOCKS), rate * times]))
    weights = np.ones(len(spins))
    solution, inverse = np.zeros(3), np.eye(3)
    for _ in range(DRIFT_ROUNDS):
        design = np.vstack([row * weight for row, weight in zip(rows, weights, strict=True)])
        aim = np.concatenate([phase * weight for phase, weight in zip(phases, weights, strict=True)])
        scale = np.linalg.norm(design, axis=0)
        inverse = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
        solution = inverse @ (design.T @ aim)
        left = [phase - row @ solution for row, phase in zip(rows, phases, strict=True)]
        weights = np.array(
            [1.0 / max(float(np.sqrt((one**2).sum() / (BLOCKS - 1.5))), 1e-15) for one in left]
        )
    residual = np.array(
        [float(phase.mean() - (row @ solution).mean()) for row, phase in zip(rows, phases, strict=True)]
    )
    drift = coarse + float(solution[2]), float(np.sqrt(inverse[2, 2]))
    covariance = np.asarray(inverse[:2, :2], dtype=np.float64)
    return RollLatency(float(solution[0]), float(solution[1]), covariance, residual, drift)


def _coarse_drift(spins: Sequence[Spin]) -> float:
    """The drift that leaves each spin's phase steadiest: a clock far off turns it round and round."""
    errors: list[FloatArray] = []
    advances: list[FloatArray] = []
    for spin in spins:
        assert spin.time_s is not None
        some = np.linspace(0, len(spin.time_s) - 1, min(len(spin.time_s), COARSE_SAMPLES)).astype(np.intp)
        errors.append((spin.roll_rad - spin.reference_rad)[some])
        advances.append(spin.rate_rad_s * spin.time_s[some])
    longest = max(float(np.ptp(advance)) for advance in advances)
    steps = max(int(np.ceil(MAX_DRIFT * longest / 0.5)), 1)
    drifts = MAX_DRIFT * np.arange(-steps, steps + 1) / steps
    steadiness = [
        sum(
            float(np.abs(np.exp(1j * (error + advance * drift)).mean()))
            for error, advance in zip(errors, advances, strict=True)
        )
        for drift in drifts
    ]
    return float(drifts[int(np.argmax(steadiness))])


def roll_of_latency_rad(latency_s: float, rate_rad_s: float) -> float:
    """How far the roll lags: 5.4 deg per millisecond at 15 rev/s."""
    return rate_rad_s * latency_s


def nonorthogonality_of_skew_rad(skew_s: float, rate_rad_s: float) -> float:
    """What y sampled `skew_s` after x adds to alpha in a spin at this rate."""
    return rate_rad_s * skew_s


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="magnetometer roll", fault=Fault.DATA, remedy=remedy + ".")
