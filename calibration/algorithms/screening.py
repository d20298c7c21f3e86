"""What of a capture can carry a coefficient, and a record of what cannot.

Nothing is filled, clipped back or averaged away: a sample or a run that is left out is named,
counted and given its reason.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MIN_STATIC_SAMPLES = 32
"""Fewer samples of a rest do not tell its noise."""
MIN_ROTATION_SAMPLES = 16
MAX_LOST_FRACTION = 0.1
"""A rest that lost more of its samples than this is not used at all."""
MAX_PERIOD_RATIO = 1.5
"""Sample spacing above this many median periods is a gap: the turn made in it was not seen."""


@dataclass(frozen=True)
class NotUsed:
    """Something in the data that no coefficient rests on: what, how many samples, why."""

    what: str
    count: int
    why: str


def saturated(samples: FloatArray, range_limit: float | None) -> NDArray[np.bool_]:
    """Which rows have a channel at the end of its range, shape (n,). `range_limit` None: none."""
    if range_limit is None:
        return np.zeros(len(samples), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.any(np.abs(samples) >= range_limit, axis=1), dtype=np.bool_)


def screen_static(
    name: str,
    samples: FloatArray,
    range_limit: float | None,
    min_samples: int = MIN_STATIC_SAMPLES,
    time_s: FloatArray | None = None,
) -> tuple[NDArray[np.intp], tuple[NotUsed, ...]]:
    """Rows of a rest that can be used (none if the rest cannot), and what was left out.

    Args:
        name: of the rest and the sensor, for the record.
        samples: shape (n, k), in the unit of `range_limit`.
        range_limit: magnitude at and above which a sample is saturated; None: not known.
        min_samples: fewer usable samples than this are too short a rest.
        time_s: shape (n,); None: gaps cannot be seen and are not looked for.
    """
    left_out: list[NotUsed] = []
    if _whole(samples, range_limit) and len(samples) >= min_samples:
        missing = clipped = np.zeros(len(samples), dtype=np.bool_)
    else:
        missing = ~np.isfinite(samples).all(axis=1)
        clipped = saturated(samples, range_limit) & ~missing
    if time_s is not None and (holes := _lost_in_gaps(time_s)):
        left_out.append(NotUsed(name, holes, "never came: gaps in time"))
    if missing.any():
        left_out.append(NotUsed(name, int(missing.sum()), "missing values (NaN)"))
    if clipped.any():
        left_out.append(NotUsed(name, int(clipped.sum()), "saturated: at the end of the range"))
    usable = np.flatnonzero(~missing & ~clipped)
    lost = len(samples) - len(usable)
    if lost > MAX_LOST_FRACTION * len(samples):
        why = f"whole rest: more than {MAX_LOST_FRACTION:.0%} of its samples are missing or saturated"
        left_out.append(NotUsed(name, len(usable), why))
        return np.empty(0, dtype=np.intp), tuple(left_out)
    if len(usable) < min_samples:
        left_out.append(NotUsed(name, len(usable), f"too short: fewer than {min_samples} samples"))
        return np.empty(0, dtype=np.intp), tuple(left_out)
    return usable, tuple(left_out)


def _whole(samples: FloatArray, range_limit: float | None) -> bool:
    """Nothing missing and nothing saturated, at the price of one look at the extremes."""
    if not samples.size:
        return False
    highest, lowest = float(samples.max()), float(samples.min())
    limit = np.inf if range_limit is None else range_limit
    return -limit < lowest and highest < limit  # NaN compares as False


def _lost_in_gaps(time_s: FloatArray) -> int:
    """Samples that a uniform record of the same span would have more."""
    spacing = np.diff(time_s)
    if len(spacing) == 0 or _even(spacing):
        return 0
    if float(spacing.max()) <= MAX_PERIOD_RATIO * float(np.median(spacing)):
        return 0
    return round(float(time_s[-1] - time_s[0]) / float(np.median(spacing))) + 1 - len(time_s)


def _even(spacing: FloatArray) -> bool:
    """No gap for certain: the median is not below the least spacing."""
    least = float(spacing.min())
    return least > 0.0 and float(spacing.max()) <= MAX_PERIOD_RATIO * least


def screen_rotation(
    name: str, time_s: FloatArray, samples: FloatArray, range_limit: float | None
) -> tuple[NotUsed, ...]:
    """Why a turn cannot be integrated; empty when it can.

    A single lost or saturated sample spoils the integral of a turn, so the whole turn is left out.

    Args:
        name: of the turn, for the record.
        time_s: shape (n,).
        samples: shape (n, 3), in the unit of `range_limit`.
        range_limit: magnitude at and above which a sample is saturated; None: not known.
    """
    count = len(samples)
    if count < MIN_ROTATION_SAMPLES:
        return (NotUsed(name, count, f"too short: fewer than {MIN_ROTATION_SAMPLES} samples"),)
    reasons: list[NotUsed] = []
    if not _whole(samples, range_limit):
        missing = int((~np.isfinite(samples).all(axis=1)).sum())
        if missing:
            reasons.append(NotUsed(name, count, f"{missing} missing values (NaN) inside the turn"))
        clipped = int(saturated(samples, range_limit).sum())
        if clipped:
            reasons.append(NotUsed(name, count, f"{clipped} saturated samples inside the turn"))
    spacing = np.diff(time_s)
    if _even(spacing):
        return tuple(reasons)
    period = float(np.median(spacing))
    if period <= 0 or bool((spacing <= 0).any()):
        reasons.append(NotUsed(name, count, "its time does not run forward"))
    else:
        gaps = int((spacing > MAX_PERIOD_RATIO * period).sum())
        if gaps:
            reasons.append(NotUsed(name, count, f"{gaps} gaps in time inside the turn"))
    return tuple(reasons)
