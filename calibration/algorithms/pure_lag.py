"""Pure lag of a fibre-optic gyro from impacts, valid for any lag (paper 3, corrected).

An impact at t_p starts a timer; the gyro's frames come every T_f, not in step with it. The first frame
that shows the impact carries the stamp d. With the lag L and the frame's phase uniform,

    d lies in [L, L + T_f)         so         max(d) - T_f < L <= min(d)

for every lag. Paper 3 sorts the trials by 'first' and 'second' frame instead, eq (11)-(18): near a frame's
edge one of the two classes is empty. Its evaluation is given beside, to be shown with its name. How many
shots a precision takes is in `pure_lag_shots`, which frame shows the impact in `impact_detection`.

Out of scope: frames that jitter, and a lag that changes between impacts (bounds that cross are refused).
"""

# pyright: strict
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import CalibrationError, Fault

FloatArray = NDArray[np.float64]

STAMP_BITS = 15
STAMP_FULL_SCALE_S = 3556.21e-6
"""Paper 3: what the 15-bit stamp holds at most; longer lags saturate it."""
MAX_SHOTS = 10_000_000
MIN_SHOTS = 2
CLOCK_TOLERANCE = 1e-9


@dataclass(frozen=True)
class TimeStamps:
    """How the rig stamps frames.

    Attributes:
        resolution_s: one count, s (paper 3, eq (23): 108.53 ns, printed 108.5).
        full_scale_s: largest stamp, s; a stamp that reaches it is saturated.
        rounding: a count holds the times from its value on ('down': a counter that is read), or
            those around it ('nearest').
    """

    resolution_s: float = STAMP_FULL_SCALE_S / (2**STAMP_BITS - 1)
    full_scale_s: float = STAMP_FULL_SCALE_S
    rounding: Literal["down", "nearest"] = "down"

    def seconds(self, counts: NDArray[np.int64]) -> FloatArray:
        """Stamps as times, s."""
        return np.asarray(counts, dtype=np.float64) * self.resolution_s

    @property
    def early_s(self) -> float:
        """How much earlier than its stamp an event can have been, s."""
        return 0.0 if self.rounding == "down" else self.resolution_s / 2.0

    @property
    def late_s(self) -> float:
        """How much later than its stamp, s."""
        return self.resolution_s if self.rounding == "down" else self.resolution_s / 2.0


PAPER_STAMPS = TimeStamps()


@dataclass(frozen=True)
class PureLag:
    """Bounds of the lag, s.

    Attributes:
        upper_s, lower_s: the lag lies between, with certainty as far as frame period and stamps hold.
        lag_s: the mid-point, paper 3, eq (19).
        half_width_s: paper 3, eq (20).
        standard_uncertainty_s: for these K shots: uniform phases and a flat prior put the lag evenly
            between the bounds, half_width / sqrt(3).
        shots: K.
    """

    upper_s: float
    lower_s: float
    lag_s: float
    half_width_s: float
    standard_uncertainty_s: float
    shots: int


def pure_lag(
    delays_s: FloatArray,
    frame_s: float,
    stamps: TimeStamps | None = PAPER_STAMPS,
    detection_s: float = 0.0,
) -> PureLag:
    """Bounds from the stamps of the first frames that show the impact.

    Args:
        delays_s: d, shape (k,), s, one an impact.
        frame_s: T_f, s.
        stamps: how d was stamped: widens the bounds by what a count hides; None: times without a count.
        detection_s: the most that passes between the impact's arrival in the output and its detection (see
            `impact_detection.latest_detection_s`): d lies in [L, L + T_f + this).

    Raises:
        CalibrationError: too few shots, missing or saturated stamps, or bounds that cross: no one lag
            fits all shots.
    """
    delays = np.asarray(delays_s, dtype=np.float64)
    if not (math.isfinite(frame_s) and frame_s > 0.0):
        raise _refused(f"The frame period {frame_s} s is none.", "give the gyro's frame period")
    if delays.ndim != 1 or len(delays) < MIN_SHOTS or len(delays) > MAX_SHOTS:
        raise _refused(
            f"A pure lag needs {MIN_SHOTS} to {MAX_SHOTS} shots, not {delays.size}.", "strike more often"
        )
    bad = int((~np.isfinite(delays) | (delays < 0.0)).sum())
    if bad:
        raise _refused(f"{bad} of {len(delays)} stamps are missing or negative.", "repeat these shots")
    if stamps is not None:
        _refuse_saturated(delays, stamps)
    early, late = (0.0, 0.0) if stamps is None else (stamps.early_s, stamps.late_s)
    upper = float(delays.min()) + late
    lower = max(float(delays.max()) - early - frame_s - detection_s, 0.0)
    if lower > upper + CLOCK_TOLERANCE * frame_s:
        raise _refused(
            f"The stamps spread over {(float(delays.max()) - float(delays.min())) * 1e6:.2f} us, more than "
            f"a frame of {frame_s * 1e6:.2f} us: no single lag fits all {len(delays)} shots.",
            "look for impacts detected a frame late (weak impacts), lost frames, or a wrong frame period",
        )
    half = max((upper - lower) / 2.0, 0.0)
    return PureLag(upper, lower, (upper + lower) / 2.0, half, half / math.sqrt(3.0), len(delays))


def _refuse_saturated(delays: FloatArray, stamps: TimeStamps) -> None:
    ended = int((delays >= stamps.full_scale_s - stamps.resolution_s / 2.0).sum())
    if ended:
        raise _refused(
            f"{ended} of {len(delays)} stamps are at the end of the timer, "
            f"{stamps.full_scale_s * 1e3:.3f} ms: the lag is longer than it can tell.",
            "use a timer with more bits or a slower clock; a saturated stamp bounds nothing",
        )


@dataclass(frozen=True)
class PaperBounds:
    """Paper 3's own evaluation, eq (16)-(20), s. `lag_s` is None where its rule has an empty class."""

    upper_s: float | None
    lower_s: float | None
    lag_s: float | None
    half_width_s: float | None


def paper_bounds(delays_s: FloatArray, frame_s: float, frame_numbers: NDArray[np.int64]) -> PaperBounds:
    """Sorted by n1 and n2 as printed: undefined when all shots show in frames of one number.

    Args:
        delays_s: d, shape (k,), s.
        frame_s: T_f, s.
        frame_numbers: n of the first frame after the impact that shows it, from 1, shape (k,).
    """
    first = int(frame_numbers.min())
    ones, twos = delays_s[frame_numbers == first], delays_s[frame_numbers == first + 1]
    upper = float(ones.min())
    if len(twos) == 0:
        return PaperBounds(upper, None, None, None)
    lower = float(twos.max()) - frame_s
    return PaperBounds(upper, lower, (upper + lower) / 2.0, (upper - lower) / 2.0)


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="pure lag", fault=Fault.DATA, remedy=remedy + ".")
