# pyright: strict
"""What a recording amounts to, in numbers a person asks for first."""

from dataclasses import dataclass

import numpy as np

from protocol.recording_checks import missing_values
from protocol.recordings import Stream

HOLE_PERIODS = 5
"""Longer than so many sample periods without a sample is a hole: nothing may be interpolated across it."""


@dataclass(frozen=True)
class StreamFacts:
    """One stream in numbers.

    Attributes:
        samples: how many.
        duration_s: from the first to the last.
        rate_hz: one over the median sample period; None with fewer than two samples, or all at once.
        holes: how many pauses are longer than `HOLE_PERIODS` periods.
        longest_pause_s: between two samples.
        missing: column → missing values, where there are any.
    """

    samples: int
    duration_s: float
    rate_hz: float | None
    holes: int
    longest_pause_s: float
    missing: dict[str, int]


def stream_facts(stream: Stream) -> StreamFacts:
    """The facts of a sound stream."""
    time_s = stream.time_s()
    pauses_s = np.diff(time_s)
    period_s = float(np.median(pauses_s)) if len(pauses_s) else 0.0
    return StreamFacts(
        samples=len(time_s),
        duration_s=float(time_s[-1] - time_s[0]) if len(time_s) else 0.0,
        rate_hz=1 / period_s if period_s > 0 else None,
        holes=int((pauses_s > HOLE_PERIODS * period_s).sum()) if period_s > 0 else 0,
        longest_pause_s=float(pauses_s.max()) if len(pauses_s) else 0.0,
        missing=missing_values(stream),
    )
