"""Bias and bias stability of a triad or of any number of channels.

    bias             mean output at rest, less what truly acts (Earth rate, gravity)
    bias stability   standard deviation of averages of 10 s over one hour (GJB 2426A: 零偏稳定性)

The bias stability of IEEE 952 is the floor of the Allan deviation (`allan_coefficients`): another quantity.
The standard deviation of averages also holds white noise (S / 10 s) and whatever slower drifts an hour has;
both are what GJB asks for, so nothing is taken out, and the trend is stated beside.

Earth rate is never silent: every function takes what truly acted, with its uncertainty. Neither is a quantum
that noise does not blur: what it hides of a mean is handed over (`quantized_mean`).
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.block_means import MIN_BLOCK_SAMPLES, BlockRecord, block_means, span_s
from calibration.algorithms.correlated_fit import (
    Blocks,
    FloatArray,
    SlowTerms,
    fit_correlated,
    refused,
)
from calibration.algorithms.earth import EARTH_RATE_RAD_S, earth_rate_ned
from calibration.algorithms.screening import NotUsed

BIAS_DURATION_S = 180.0
STABILITY_DURATION_S = 3600.0
STABILITY_AVERAGE_S = 10.0
BLOCKS_OF_A_BIAS = 60
MAX_LOST_FRACTION = 0.1
"""Of a record's blocks; beyond it the record is not the one that was asked for."""


@dataclass(frozen=True)
class TrueInput:
    """What truly acted at rest on m channels.

    Attributes:
        value: shape (m,), SI, as the sensors see it: M times the input where M is known (1e-3 of the Earth
            rate is 0.015 deg/h).
        standard_uncertainty: shape (m,), SI.
        words: where it comes from.
    """

    value: FloatArray
    standard_uncertainty: FloatArray
    words: str


def earth_rate_at_rest(
    dcm_body_from_ned: FloatArray,
    latitude_rad: float,
    attitude_standard_uncertainty_rad: float = 0.0,
) -> TrueInput:
    """The Earth rate in body axes for a known attitude and latitude."""
    body = dcm_body_from_ned @ earth_rate_ned(latitude_rad)
    # A small turn about any axis moves the vector across itself: sqrt(|w|^2 - w_i^2) per rad.
    across = np.sqrt(np.maximum(EARTH_RATE_RAD_S**2 - body**2, 0.0))
    words = f"Earth rate at {math.degrees(latitude_rad):.4g} deg latitude in the known attitude"
    return TrueInput(body, across * attitude_standard_uncertainty_rad, words)


def unknown_earth_rate(channels: int = 3) -> TrueInput:
    """Latitude or attitude are unknown: the Earth rate stays in the bias and is its uncertainty."""
    doubt = np.full(channels, EARTH_RATE_RAD_S / math.sqrt(3.0))
    return TrueInput(np.zeros(channels), doubt, "Earth rate not known in body axes: part of the uncertainty")


@dataclass(frozen=True)
class BiasFigure:
    """The bias of one record.

    Attributes:
        bias: shape (m,), SI, at the output.
        covariance: shape (m, m); the channels' noise is independent.
        trend_per_s, trend_standard_uncertainty: slope over the record, (m,): a unit that still warms up.
        true_input, noise: what was assumed.
        of_quantum: standard uncertainty that the quantum adds to the mean, (m,).
        not_used: what the bias does not rest on.
    """

    bias: FloatArray
    covariance: FloatArray
    trend_per_s: FloatArray
    trend_standard_uncertainty: FloatArray
    true_input: TrueInput
    of_quantum: FloatArray
    noise: tuple[str, ...]
    not_used: tuple[NotUsed, ...]

    @property
    def of_mean(self) -> FloatArray:
        """Standard uncertainty of the mean alone, (m,): what truly acts stays out."""
        variance = self.standard_uncertainty**2 - self.true_input.standard_uncertainty**2
        return np.sqrt(np.maximum(variance, 0.0))

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Shape (m,)."""
        return np.asarray(np.sqrt(np.einsum("ii->i", self.covariance)))


def bias(
    time_s: FloatArray,
    output: FloatArray,
    true_input: TrueInput,
    *,
    duration_s: float = BIAS_DURATION_S,
    range_limit: float | None = None,
    known_slow: SlowTerms | None = None,
    of_quantum: FloatArray | float = 0.0,
    where: str = "bias",
) -> BiasFigure:
    """The bias from a rest of at least `duration_s`; all of it is used.

    Args:
        time_s: shape (n,).
        output: shape (n, m), SI.
        true_input: what truly acted, (m,).
        duration_s: the least that counts as a bias test.
        range_limit: see `block_means`.
        known_slow: see `correlated_fit`. With an infinite correlation time (turn-on repeatability) the bias
            stands for the unit, without it for this power-on.
        of_quantum: standard uncertainty of each channel's mean by its quantum, (m,) or one for all, SI.
        where: for errors.

    Raises:
        CalibrationError: a record that is too short or has lost more than a tenth.
    """
    _check_channels(output, true_input, where)
    period_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    block_s = max(span_s(time_s) / BLOCKS_OF_A_BIAS, MIN_BLOCK_SAMPLES * period_s)
    record = _complete(where, time_s, output, block_s, range_limit, duration_s)
    ones = np.ones((len(record.blocks.middle_s), 1))
    fit = fit_correlated(ones, record.blocks, ("bias",), where, known_slow)
    trend, u_trend = _trend(record, where, known_slow)
    by_quantum = np.asarray(np.broadcast_to(of_quantum, output.shape[1]), dtype=np.float64)
    variance = fit.covariance[:, 0, 0] + true_input.standard_uncertainty**2 + by_quantum**2
    return BiasFigure(
        bias=fit.values[:, 0] - true_input.value,
        covariance=np.eye(len(variance)) * variance,
        trend_per_s=trend,
        trend_standard_uncertainty=u_trend,
        true_input=true_input,
        of_quantum=by_quantum,
        noise=fit.noise,
        not_used=record.not_used,
    )


@dataclass(frozen=True)
class BiasStability:
    """Standard deviation of averages over a record.

    Attributes:
        stability: s of the averages, shape (m,), SI.
        degrees_of_freedom: what s^2 is worth in independent averages, (m,): few where the bias wanders.
        averages: how many.
        average_s, duration_s: of one average; of all.
        trend_per_s, trend_standard_uncertainty: (m,); a trend r over T adds r T / sqrt(12) to s.
        of_quantum: standard uncertainty that the quantum adds to each average, (m,).
        noise, not_used: as `BiasFigure`.
    """

    stability: FloatArray
    degrees_of_freedom: FloatArray
    averages: int
    average_s: float
    duration_s: float
    trend_per_s: FloatArray
    trend_standard_uncertainty: FloatArray
    of_quantum: FloatArray
    noise: tuple[str, ...]
    not_used: tuple[NotUsed, ...]

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Of s, for normal noise: s / sqrt(2 nu), with the quantum's part, shape (m,)."""
        return np.hypot(self.stability / np.sqrt(2.0 * self.degrees_of_freedom), self.of_quantum)

    def interval(self, probability: float) -> FloatArray:
        """What another hour's expected s lies in, shape (m, 2): chi-square with nu degrees of freedom."""
        return scatter_interval(self.stability, self.degrees_of_freedom, probability, self.of_quantum)


def bias_stability(
    time_s: FloatArray,
    output: FloatArray,
    *,
    average_s: float = STABILITY_AVERAGE_S,
    duration_s: float = STABILITY_DURATION_S,
    range_limit: float | None = None,
    known_slow: SlowTerms | None = None,
    of_quantum: FloatArray | float = 0.0,
    where: str = "bias stability",
) -> BiasStability:
    """Standard deviation of averages of `average_s` over the first `duration_s` of a record.

    The Earth rate at rest is constant and drops out.

    Raises:
        CalibrationError: a record that is too short or has lost more than a tenth of its averages.
    """
    within = time_s - time_s[:1] < duration_s - 1e-6 * average_s
    record = _complete(where, time_s[within], output[within], average_s, range_limit, duration_s)
    means = record.blocks.means
    ones = np.ones((len(means), 1))
    fit = fit_correlated(ones, record.blocks, ("bias",), where, known_slow)
    trend, u_trend = _trend(record, where, known_slow)
    return BiasStability(
        stability=means.std(axis=0, ddof=1),
        degrees_of_freedom=fit.scatter_degrees_of_freedom,
        averages=len(means),
        average_s=average_s,
        duration_s=duration_s,
        trend_per_s=trend,
        trend_standard_uncertainty=u_trend,
        of_quantum=np.asarray(np.broadcast_to(of_quantum, output.shape[1]), dtype=np.float64),
        noise=fit.noise,
        not_used=record.not_used,
    )


def scatter_interval(
    scatter: FloatArray,
    degrees_of_freedom: FloatArray,
    probability: float,
    of_quantum: FloatArray | float = 0.0,
) -> FloatArray:
    """Interval of a standard deviation, shape (m, 2): nu s^2 / chi-square, equal tails.

    Errors of the values move s by no more than their own root mean square (triangle inequality about the
    mean): where a quantum hides `of_quantum` of each, both ends go sqrt(3) of it further, half a quantum
    where there is no noise.
    """
    tail = (1.0 - probability) / 2.0
    low = np.asarray(chdtri(degrees_of_freedom, tail), dtype=np.float64)
    high = np.asarray(chdtri(degrees_of_freedom, 1.0 - tail), dtype=np.float64)
    wider = math.sqrt(3.0) * np.asarray(of_quantum)
    return np.stack(
        [
            np.maximum(scatter * np.sqrt(degrees_of_freedom / low) - wider, 0.0),
            scatter * np.sqrt(degrees_of_freedom / high) + wider,
        ],
        axis=1,
    )


def _complete(
    where: str,
    time_s: FloatArray,
    output: FloatArray,
    block_s: float,
    range_limit: float | None,
    duration_s: float,
) -> BlockRecord:
    """Blocks of a record that is long enough and nearly whole."""
    length_s = span_s(time_s)
    if length_s < duration_s * (1.0 - 1e-3):
        raise refused(
            f"The record lasts {length_s:.6g} s, which is too short: {duration_s:g} s are asked for.",
            where,
            f"record at least {duration_s:g} s.",
        )
    record = block_means(where, time_s, output, block_s, range_limit=range_limit)
    if record.lost_fraction > MAX_LOST_FRACTION:
        reasons = "; ".join(f"{note.count} {note.why}" for note in record.not_used)
        raise refused(
            f"{record.lost_fraction:.0%} of the record cannot be used: {reasons}.", where, "record again."
        )
    return record


def _trend(record: BlockRecord, where: str, known_slow: SlowTerms | None) -> tuple[FloatArray, FloatArray]:
    """Slope, from groups of blocks: a slope needs no short ones."""
    every = max(1, len(record.blocks.middle_s) // BLOCKS_OF_A_BIAS)
    whole = len(record.blocks.middle_s) // every * every
    groups = Blocks(
        record.blocks.middle_s[:whole].reshape(-1, every).mean(axis=1),
        record.blocks.duration_s[:whole].reshape(-1, every).sum(axis=1),
        record.blocks.means[:whole].reshape(len(record.blocks.middle_s) // every, every, -1).mean(axis=1),
    )
    middle = groups.middle_s - groups.middle_s.mean()
    design = np.column_stack([np.ones(len(middle)), middle])
    return fit_correlated(design, groups, ("bias", "trend"), where, known_slow).of("trend")


def _check_channels(output: FloatArray, true_input: TrueInput, where: str) -> None:
    channels = output.shape[1] if output.ndim == 2 else 0
    if true_input.value.shape != (channels,) or not np.isfinite(true_input.value).all():
        raise refused(
            f"The true input has the shape {true_input.value.shape}, the output {output.shape}.",
            where,
            "state what truly acts on each channel.",
        )
