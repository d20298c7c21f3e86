# pyright: strict
"""Interval of a fraction that was counted, pure."""

import math
from dataclasses import dataclass

Z_95 = 1.959963984540054
"""The 97.5 % point of the standard normal distribution (two-sided 95 %)."""


@dataclass(frozen=True)
class CountedFraction:
    """`successes` out of `trials`, with the Wilson interval of the underlying probability.

    `fraction`, `low` and `high` are None when nothing was tried: no yield is not a yield of zero.
    """

    successes: int
    trials: int
    fraction: float | None
    low: float | None
    high: float | None


def counted_fraction(successes: int, trials: int, z: float = Z_95) -> CountedFraction:
    """The fraction with its Wilson score interval.

    Wilson (1927), J. Am. Stat. Assoc. 22:209. It stays inside [0, 1] and is honest at 0 and at all
    successes, where the usual normal interval has no width: both are common on a young line.

    Raises:
        ValueError: the counts are not 0 ≤ successes ≤ trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials cannot be")
    if trials == 0:
        return CountedFraction(0, 0, None, None, None)
    fraction = successes / trials
    denominator = 1 + z * z / trials
    centre = (fraction + z * z / (2 * trials)) / denominator
    half_width = z / denominator * math.sqrt(fraction * (1 - fraction) / trials + (z / (2 * trials)) ** 2)
    # At the ends the interval touches 0 or 1 exactly; rounding must not push it past them.
    low = 0.0 if successes == 0 else max(0.0, centre - half_width)
    high = 1.0 if successes == trials else min(1.0, centre + half_width)
    return CountedFraction(successes, trials, fraction, low, high)
