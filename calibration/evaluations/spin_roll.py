"""Roll by the corrected magnetometer against the stand's angle: its error, and the latency of a fast spin.

A spin of several speeds tells a latency from how the magnetometer was mounted, see `roll_error`. The field
in the unit's axes turns against the unit: theta = mounting - angle.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.magnetometer_spin import SpinCoefficients
from calibration.algorithms.roll_error import (
    BLOCKS,
    MIN_BLOCK,
    RollError,
    RollLatency,
    Spin,
    roll_error,
    roll_latency,
)
from protocol.errors import CalibrationError
from protocol.recordings import Recording, Stream

STEADY_PART = 1e-3
"""Of the highest rate: a rate that changes less within a second is a level."""
LEVEL_PART = 0.02
"""Of the highest rate: levels closer than this are one."""
MIN_TURNS = 2.0
ANGLES = ("angle_outer", "angle_middle", "angle_inner")


@dataclass(frozen=True)
class SpinRoll:
    """Error of the roll at the highest level, and the latency from all levels; None: one level only."""

    rate_rad_s: float
    error: RollError
    latency: RollLatency | None
    levels: int


def roll_against_stand(
    recording: Recording,
    dut: Stream,
    axis: int,
    found: SpinCoefficients,
    both: FloatArray,
    used: NDArray[np.bool_],
) -> SpinRoll | None:
    """What the stand's encoders say of the roll; None: no encoder, no trigger, or no steady level.

    Args:
        recording: with a stand whose gimbal turned about body `axis`.
        dut: the unit's stream.
        axis: 0 … 2.
        found: corrections of the two channels.
        both: their outputs, shape (n, 2).
        used: which of them, shape (n,).
    """
    stand = recording.streams.get("stand")
    if stand is None or recording.test.get("triggered") is False:
        return None
    angle = _gimbal(stand)
    if angle is None:
        return None
    time_s, stand_s = dut.time_s(), stand.time_s()
    rate = np.gradient(angle, stand_s)
    sign = np.sign(float(np.dot(rate, stand.si(f"rate_{'xyz'[axis]}"))))
    inside = used & (time_s >= stand_s[0]) & (time_s <= stand_s[-1])
    reference = -sign * np.interp(time_s, stand_s, angle)
    of_sample = sign * np.interp(time_s, stand_s, rate)
    spins = [
        Spin(
            -float(of_sample[rows].mean()),
            found.roll_rad(both[rows, 0], both[rows, 1]),
            reference[rows],
            time_s[rows],
        )
        for rows in _levels(time_s, of_sample, inside)
    ]
    if not spins:
        return None
    fastest = max(spins, key=lambda spin: abs(spin.rate_rad_s))
    try:
        latency = roll_latency(spins) if len(spins) > 1 else None
    except CalibrationError:
        latency = None  # levels too close to each other
    error = roll_error(fastest.roll_rad, fastest.reference_rad)
    return SpinRoll(abs(fastest.rate_rad_s), error, latency, len(spins))


def _gimbal(stand: Stream) -> FloatArray | None:
    """Angle of the gimbal that turned furthest, unwrapped, rad."""
    angles = [np.unwrap(stand.si(name)) for name in ANGLES if name in stand.columns]
    angles = [angle for angle in angles if np.isfinite(angle).all()]
    if not angles:
        return None
    furthest = max(angles, key=lambda angle: float(np.ptp(angle)))
    return furthest if float(np.ptp(furthest)) > 2.0 * np.pi * MIN_TURNS else None


def _levels(time_s: FloatArray, rate_rad_s: FloatArray, inside: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Rows of each steady level: whole turns of it, so that harmonics do not leak into the mean."""
    highest = float(np.abs(rate_rad_s[inside]).max(initial=0.0))
    if highest == 0.0:
        return []
    window = max(1, round(1.0 / float(np.median(np.diff(time_s)))))
    steady = np.zeros(len(time_s), dtype=np.bool_)
    if len(time_s) > window:
        steady[:-window] = np.abs(rate_rad_s[window:] - rate_rad_s[:-window]) < STEADY_PART * highest
    kept = steady & inside & (np.abs(rate_rad_s) > LEVEL_PART * highest)
    found: list[NDArray[np.intp]] = []
    levels = np.round(rate_rad_s[kept] / (LEVEL_PART * highest)).astype(np.int64)
    for level in np.unique(levels):
        rows = np.flatnonzero(kept)[levels == level]
        turns = float(np.abs(rate_rad_s[rows]).mean()) * (time_s[rows[-1]] - time_s[rows[0]]) / (2 * np.pi)
        if len(rows) >= BLOCKS * MIN_BLOCK and turns >= MIN_TURNS:
            found.append(rows)
    return found
