"""The 1 sigma of an attitude error, phase by phase, and how well one run tells it.

1 sigma is the root mean square about zero: a constant error is an error. Errors of an attitude have a memory,
so n samples are worth fewer independent ones:

    nu = n / (1 + 2 sum_k (1 - k/n) rho(k)^2)        (variance of the mean square, normal errors of mean 0)

rho from the errors themselves, without taking a mean off, summed to three times the lag at which it first
falls below 0.1: beyond, its own noise would be squared and added. sigma^2 nu is then chi-square of nu degrees
of freedom about the true variance, which gives an interval of the 1 sigma. A slow error counts once (nu near
1), and the interval says how little one run tells then. An error common to all runs of a unit does not show.
"""

# pyright: strict
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.coefficients import FloatArray
from protocol.errors import CalibrationError, Fault

MIN_SAMPLES = 20
UNCORRELATED = 0.1
TIMES_FIRST_FALL = 3
OVERALL = "overall"


@dataclass(frozen=True)
class ErrorFigure:
    """Of one angle in one phase, rad.

    Attributes:
        sigma: root mean square.
        mean: of the error.
        largest: magnitude.
        independent_samples: nu.
        samples: that it rests on.
    """

    sigma: float
    mean: float
    largest: float
    independent_samples: float
    samples: int

    def standard_uncertainty(self, of_reference: float = 0.0) -> float:
        """Of sigma: its scatter, and what the reference (its mounting included) may err."""
        return math.hypot(self.sigma / math.sqrt(2.0 * self.independent_samples), of_reference)

    def interval(self, probability: float, of_reference: float = 0.0) -> tuple[float, float]:
        """Where the true 1 sigma lies with this probability."""
        nu, tail = self.independent_samples, 0.5 * (1.0 - probability)
        lower = self.sigma * math.sqrt(nu / float(chdtri(nu, tail)))
        upper = self.sigma * math.sqrt(nu / float(chdtri(nu, 1.0 - tail)))
        wider = 2.0 * of_reference
        low = self.sigma - math.hypot(self.sigma - lower, wider)
        return max(low, 0.0), self.sigma + math.hypot(upper - self.sigma, wider)


def error_figure(error: FloatArray) -> ErrorFigure:
    """Of errors (n,) at even instants; stretches that belong together come one after the other.

    Raises:
        CalibrationError: too few, or not numbers.
    """
    if len(error) < MIN_SAMPLES or not np.isfinite(error).all():
        raise CalibrationError(
            f"{int(np.isfinite(error).sum())} errors are too few to tell a 1 sigma, or some are missing.",
            where="errors of the attitude",
            fault=Fault.DATA,
            remedy=f"hand over at least {MIN_SAMPLES}.",
        )
    return ErrorFigure(
        sigma=math.sqrt(float(np.mean(error**2))),
        mean=float(error.mean()),
        largest=float(np.abs(error).max()),
        independent_samples=effective_samples(error),
        samples=len(error),
    )


def effective_samples(error: FloatArray) -> float:
    """nu of the mean square of errors (n,); see the module. At least 1."""
    count = len(error)
    spectrum = np.fft.rfft(error, 1 << (2 * count - 1).bit_length())
    power = np.asarray(np.fft.irfft(np.abs(spectrum) ** 2)[:count], dtype=np.float64)
    if power[0] <= 0.0:
        return float(count)
    weight = 1.0 - np.arange(count) / count
    correlation = power / power[0] / weight
    fallen = np.flatnonzero(correlation < UNCORRELATED)
    last = min(count, TIMES_FIRST_FALL * int(fallen[0])) if len(fallen) else count
    total = float(np.sum(weight[1:last] * correlation[1:last] ** 2))
    return max(1.0, count / (1.0 + 2.0 * total))


def figures_by_phase(
    error: FloatArray, phase: NDArray[np.str_], usable: NDArray[np.bool_]
) -> Mapping[str, ErrorFigure]:
    """Figures of errors (n,) in each phase that has enough samples, in order of appearance, and of all.

    Args:
        error: rad.
        phase: (n,) names.
        usable: (n,); what is not is left out.
    """
    found: dict[str, ErrorFigure] = {}
    for name in dict.fromkeys(phase[usable].tolist()):
        inside = usable & (phase == name)
        if int(inside.sum()) >= MIN_SAMPLES:
            found[name] = error_figure(error[inside])
    found[OVERALL] = error_figure(error[usable])
    return found


def wrapped_rad(angle_rad: FloatArray) -> FloatArray:
    """Into [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi
