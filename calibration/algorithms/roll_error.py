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
    """

    rate_rad_s: float
    roll_rad: FloatArray
    reference_rad: FloatArray


@dataclass(frozen=True)
class RollLatency:
    """Latency and mounting angle.

    Attributes:
        latency_s: tau; the roll is late by it.
        mounting_rad: rotation of the magnetometer's x from the reference's zero.
        covariance: of (latency, mounting), shape (2, 2).
        residual_rad: of each spin's phase from the line, shape (k,).
    """

    latency_s: float
    mounting_rad: float
    covariance: FloatArray
    residual_rad: FloatArray

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
    errors = [roll_error(spin.roll_rad, spin.reference_rad) for spin in spins]
    phases = np.array([error.mean for error in errors])
    uncertainties = np.array([error.mean_standard_uncertainty for error in errors])
    weights = 1.0 / np.maximum(uncertainties, 1e-15)
    design = np.column_stack([-rates, np.ones(len(rates))])
    weighted = design * weights[:, None]
    solution, *_ = np.linalg.lstsq(weighted, phases * weights, rcond=None)
    covariance = np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)
    return RollLatency(float(solution[0]), float(solution[1]), covariance, phases - design @ solution)


def roll_of_latency_rad(latency_s: float, rate_rad_s: float) -> float:
    """How far the roll lags: 5.4 deg per millisecond at 15 rev/s."""
    return rate_rad_s * latency_s


def nonorthogonality_of_skew_rad(skew_s: float, rate_rad_s: float) -> float:
    """What y sampled `skew_s` after x adds to alpha in a spin at this rate."""
    return rate_rad_s * skew_s


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="magnetometer roll", fault=Fault.DATA, remedy=remedy + ".")
