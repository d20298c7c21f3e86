"""How many impacts a precision of the pure lag takes, with random and with programmed instants.

Paper 3, eq (22), treats the K(K-1)/2 pairs of trials as independent. In truth the range of K uniform
phases decides: with a = 2 delta / T_f

    P(half width <= delta)      = 1 - (1 - a)^(K-1) (1 + (K-1) a)
    P(|mid-point - L| <= delta) = 1 - (1 - a)^K

The paper's rule of 'first' and 'second' frames does worse near a frame's edge: `paper_rule_confidence`.
Its outlook, an impact at a programmed instant, halves the bracket with each shot: 5 shots where random
ones take 64.
"""

# pyright: strict
import math
from collections.abc import Callable
from typing import Literal

from calibration.algorithms.pure_lag import MAX_SHOTS, PureLag
from protocol.errors import CalibrationError, Fault

Aim = Literal["half_width", "mid_point"]

MAX_PROGRAMMED_SHOTS = 64
"""Halvings of a frame beyond this are below the resolution of a double."""


def confidence(shots: int, precision_s: float, frame_s: float, aim: Aim = "half_width") -> float:
    """Probability that K shots at random phases reach a precision, whatever the lag.

    Args:
        shots: K, at least 1.
        precision_s: delta, s.
        frame_s: T_f, s.
        aim: 'half_width': the stated half width; 'mid_point': the error of the mid-point.

    Raises:
        CalibrationError: arguments that are not positive.
    """
    part = _part(shots, precision_s, frame_s)
    if part >= 1.0:
        return 1.0
    # Through logarithms: thousands of shots and parts of 1e-4 keep their digits.
    if aim == "mid_point":
        return -math.expm1(shots * math.log1p(-part))
    return -math.expm1((shots - 1) * math.log1p(-part) + math.log1p((shots - 1) * part))


def paper_confidence(shots: int, precision_s: float, frame_s: float) -> float:
    """Paper 3, eq (22) as printed: too high, 99.07 % where the truth is 83.04 %."""
    part = _part(shots, precision_s, frame_s)
    pairs = shots * (shots - 1) / 2.0
    if part >= 1.0:
        return 1.0 if pairs else 0.0
    return -math.expm1(pairs * math.log1p(-(part**2)))


def paper_rule_confidence(
    shots: int, precision_s: float, frame_s: float, lag_s: float
) -> tuple[float, float]:
    """What paper 3's n1/n2 rule, eq (11)-(20), truly reaches, and how often it has no bracket at all.

    With p the lag's part of a frame above whole frames (or below, if nearer), the gaps u above and v < p
    below the edge have the density K (K-1) (1 - u - v)^(K-2).

    Args:
        shots, precision_s, frame_s: as for `confidence`.
        lag_s: L, s: the rule depends on it.

    Returns:
        Probability of a bracket within the precision; probability of an empty class.
    """
    part = min(_part(shots, precision_s, frame_s), 1.0)
    above = math.fmod(lag_s, frame_s) / frame_s
    nearest = min(above, 1.0 - above)
    empty = (1.0 - above) ** shots + above**shots

    def within(bracket: float) -> float:
        return 1.0 - (1.0 - bracket) ** (shots - 1) * (1.0 + (shots - 1) * bracket)

    if part <= nearest:
        return within(part), empty
    shorter = min(part, 1.0 - nearest)
    reached = within(nearest) + nearest * shots * (
        (1.0 - nearest) ** (shots - 1) - (1.0 - shorter) ** (shots - 1)
    )
    if part > shorter:
        reached += (shots - 1) * (nearest**shots - (1.0 - part) ** shots)
    return reached, empty


def shots_needed(precision_s: float, frame_s: float, level: float = 0.99, aim: Aim = "half_width") -> int:
    """Least number of shots at random phases that reaches a precision with this probability.

    Raises:
        CalibrationError: more than `MAX_SHOTS`, or a level outside 0 … 1.
    """
    return _fewest(lambda shots: confidence(shots, precision_s, frame_s, aim), level)


def paper_shots_needed(precision_s: float, frame_s: float, level: float = 0.99) -> int:
    """The same by eq (22) as printed: 31 where it takes 64."""
    return _fewest(lambda shots: paper_confidence(shots, precision_s, frame_s), level)


def next_frame_after_impact_s(bounds: PureLag, frame_s: float) -> float:
    """When a frame should come after the next impact, in 0 … T_f, to halve the bracket (paper 3, outlook).

    A frame that comes at the middle of the bracket shows the impact, then the middle is the new upper
    bound, or does not, then the lower one. The instant need not be met exactly: `pure_lag` takes the
    stamp as it came.
    """
    return math.fmod(bounds.lag_s, frame_s)


def programmed_shots_needed(precision_s: float, frame_s: float, instant_error_s: float = 0.0) -> int:
    """Shots at programmed instants that reach a half width for certain.

    The first may fall anywhere and leaves one frame; each further one halves the bracket but for the
    error of its instant, at most `instant_error_s`.

    Raises:
        CalibrationError: the error of the instant is as large as the precision.
    """
    _part(1, precision_s, frame_s)
    if instant_error_s < 0.0 or instant_error_s >= precision_s:
        raise _refused(
            f"Instants within {instant_error_s * 1e6:g} us do not carry a precision of "
            f"{precision_s * 1e6:g} us for certain.",
            "time the impact better, or strike at random phases (see the number of shots for those)",
        )
    width, shots = frame_s, 1
    while width > 2.0 * precision_s * (1.0 + 1e-12) and shots < MAX_PROGRAMMED_SHOTS:
        width, shots = width / 2.0 + instant_error_s, shots + 1
    if shots == MAX_PROGRAMMED_SHOTS:
        raise _refused(
            f"More than {MAX_PROGRAMMED_SHOTS} programmed shots would be needed.",
            "ask for a coarser precision",
        )
    return shots


def _fewest(reached: Callable[[int], float], level: float) -> int:
    if not 0.0 < level < 1.0:
        raise _refused(f"A confidence of {level} is none between 0 and 1.", "give for example 0.99")
    high = 2
    while reached(high) < level:
        high *= 2
        if high > MAX_SHOTS:
            raise _refused(
                f"More than {MAX_SHOTS} shots would be needed.",
                "ask for a coarser precision, or program the instant",
            )
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if reached(middle) >= level else (middle, high)
    return high


def _part(shots: int, precision_s: float, frame_s: float) -> float:
    """a = 2 delta / T_f."""
    if shots < 1 or not (math.isfinite(precision_s) and precision_s > 0.0):
        raise _refused(f"{shots} shots and {precision_s} s are no plan.", "give positive numbers")
    if not (math.isfinite(frame_s) and frame_s > 0.0):
        raise _refused(f"The frame period {frame_s} s is none.", "give the gyro's frame period")
    return 2.0 * precision_s / frame_s


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="pure lag, shots", fault=Fault.PLAN, remedy=remedy + ".")
