"""Transfer function, -3 dB bandwidth, delay and lag from a sine sweep (IEEE 528: frequency response).

A sweep from rest to rest is a transient: its Fourier sums obey Y = H U without leakage. In a band

    Y(f) = (H + H' (f - f_band)) U(f) + noise

is a complex regression over the band's bins. What is left is the noise *at these frequencies*, of whatever
colour, so H comes with its uncertainty band by band, and slow noise troubles the lowest bands alone. Then

    H(f) = K e^{-i w L} / (1 + i w tau)

is fitted to all bands: pure delay L and first-order lag tau. At low frequency both give the same phase,
-w (L + tau): the *total* delay is always told, the parts only where amplitude falls or phase bends. tau is
integrated over, so the uncertainties hold without that too; `separated` and `words` say which it is.

The reference has to be on the unit's clock. What the two clocks may be apart goes into the delay. Samples
that are missing are predicted from H until that stays (expectation maximisation), and counted; few may be.
Frequencies in Hz, times in s.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.correlated_fit import FloatArray, refused
from calibration.algorithms.screening import NotUsed

BINS_PER_BAND = 10
BAND_RATIO = 1.12
"""A band has so many bins, and its upper end is at least this ratio above its lower one."""
FINER = 16
"""The reference is made finer by this factor (Fourier series): lines between its samples are then exact."""
MIN_BANDS = 5
MIN_EXCITATION = 0.2
"""A sweep lasts from and to where the spectrum, or it times frequency, is above this part of its largest."""
MAX_NYQUIST_PART = 0.9
MAX_LOST_FRACTION = 0.01
"""More lost samples than this are not predicted."""
OUTLIER_SIGMAS = 8.0
MIN_OUTLIER_PART = 0.02
"""Of the largest output: what the bands' edges leave in a record without noise is no outlier."""
MAX_JITTER_PERIODS = 0.1
PASSES = 8
HALF_POWER = 1.0 / math.sqrt(2.0)
NEAR_RATIO = 1.6
"""Bands within this ratio of the bandwidth tell it."""
TAU_STEPS = 400
SEEN_CHI_SQUARE = 9.0
"""A lag is seen, apart from a delay, where chi-square grows by more than this without it (3 sigma)."""

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class FrequencyResponse:
    """H band by band.

    Attributes:
        frequency_hz: of each band, weighted with the sweep's power, shape (b,).
        response: H, shape (b,).
        covariance: of (Re H, Im H), shape (b, 2, 2); bands are independent.
        not_used: samples, why.
    """

    frequency_hz: FloatArray
    response: ComplexArray
    covariance: FloatArray
    not_used: tuple[NotUsed, ...]

    @property
    def gain(self) -> FloatArray:
        """|H|, shape (b,)."""
        return np.abs(self.response)

    def polar_covariance(self) -> FloatArray:
        """Of (ln |H|, phase), shape (b, 2, 2)."""
        real, imaginary = self.response.real, self.response.imag
        square = np.abs(self.response) ** 2
        turn = np.array([[real, imaginary], [-imaginary, real]]) / square
        return np.einsum("pib,bij,qjb->bpq", turn, self.covariance, turn)


@dataclass(frozen=True)
class DelayAndLag:
    """What the bands say of time.

    Attributes:
        gain: K, at low frequency, and its standard uncertainty.
        total_delay_s: L + tau, the delay at low frequency.
        delay_s, time_constant_s: L and tau, each with its standard uncertainty; strongly correlated where
            `separated` is false.
        covariance: of (ln K, L, tau), shape (3, 3), the clocks' part in L included.
        separated: the data tell a lag from a delay.
        time_constant_below_s: what tau is below with 95 %.
        bandwidth_hz: where |H| falls through K / sqrt(2) inside the sweep, and its standard uncertainty;
            None: it does not.
        bandwidth_above_hz: with 97.5 % the bandwidth is above this.
        chi_square_ratio: of the model; well above 1: the unit has another dynamics.
        words: what is separated and what is not.
    """

    gain: tuple[float, float]
    total_delay_s: tuple[float, float]
    delay_s: tuple[float, float]
    time_constant_s: tuple[float, float]
    covariance: FloatArray
    separated: bool
    time_constant_below_s: float
    bandwidth_hz: tuple[float, float] | None
    bandwidth_above_hz: float
    chi_square_ratio: float
    words: str


def frequency_response(
    time_s: FloatArray,
    output: FloatArray,
    reference_time_s: FloatArray,
    reference: FloatArray,
    *,
    range_limit: float | None = None,
    where: str = "frequency response",
) -> FrequencyResponse:
    """H of one channel from one sweep, from rest to rest.

    Args:
        time_s, output: of the unit, shape (n,), uniform but for lost samples.
        reference_time_s, reference: what truly acted on the channel, shape (r,), uniform and whole, on the
            unit's clock.
        range_limit: magnitude at and above which an output is saturated.
        where: for errors.

    Raises:
        CalibrationError: saturation, too many lost samples, a reference with gaps, too few bands.
    """
    period, place = _grid(time_s, where)
    count = int(place[-1]) + 1
    acted = _acted(time_s[0] + period * np.arange(count), reference_time_s, reference, where)
    whole = np.full(count, np.nan)
    whole[place] = output
    if range_limit is not None and (clipped := int((np.abs(output) >= range_limit).sum())):
        raise refused(
            f"{clipped} samples are saturated: what they cut off is in every frequency.",
            where,
            "sweep with less amplitude.",
        )
    bins, missing, wild = _settled(whole, acted, period, where)
    notes = [
        NotUsed(where, int(which.sum()), f"{why}, predicted from the rest")
        for which, why in (
            (missing, "missing (gaps in time or NaN)"),
            (wild, f"outliers beyond {OUTLIER_SIGMAS:g} standard deviations"),
        )
        if which.any()
    ]
    half = np.array([one[2] for one in bins]) / 2.0
    return FrequencyResponse(
        np.array([one[0] for one in bins]),
        np.array([one[1] for one in bins]),
        half[:, None, None] * np.eye(2),
        tuple(notes),
    )


def _settled(
    whole: FloatArray, acted: FloatArray, period: float, where: str
) -> tuple[list[tuple[float, complex, float]], NDArray[np.bool_], NDArray[np.bool_]]:
    """Bands (frequency, H, variance) once lost samples are predicted; which are missing; which are wild."""
    missing = np.isnan(whole)
    frequency = np.asarray(np.fft.rfftfreq(len(whole), period), dtype=np.float64)
    spectrum = np.fft.rfft(acted)
    bands = _bands(frequency, spectrum, where)
    lost, wild = missing, np.zeros(len(whole), dtype=np.bool_)
    filled = np.where(missing, 0.0, whole)
    bins: list[tuple[float, complex, float]] = []
    for number in range(PASSES):
        answered = np.fft.rfft(filled)
        bins = [_regress(frequency[band], spectrum[band], answered[band]) for band in bands]
        predicted = _predicted(frequency, spectrum, bins, len(whole))
        if number >= 2:
            wild = _outliers(whole - predicted, MIN_OUTLIER_PART * float(np.abs(predicted).max()))
            lost = missing | wild
        slope, mean = np.polyfit(np.flatnonzero(~lost), (whole - predicted)[~lost], 1)
        filled = np.where(lost, predicted, whole - mean - slope * np.arange(len(whole)))
    if lost.mean() > MAX_LOST_FRACTION:
        raise refused(
            f"{lost.mean():.1%} of the samples are missing or outliers.", where, "record the sweep again."
        )
    return bins, missing, wild


def delay_and_lag(response: FrequencyResponse, *, clock_standard_uncertainty_s: float = 0.0) -> DelayAndLag:
    """K, L and tau, the -3 dB bandwidth, and what of them the sweep can tell.

    For each tau on a grid ln K and L follow by linear least squares; tau is weighed by its likelihood (flat
    prior for tau >= 0), and mean and covariance are those of the mixture.
    """
    omega = 2.0 * math.pi * response.frequency_hz
    weights = np.asarray(np.linalg.inv(response.polar_covariance()), dtype=np.float64)
    log_gain, phase = np.log(response.gain), np.unwrap(np.angle(response.response))
    phase = phase - 2.0 * math.pi * round(float(phase[0]) / (2.0 * math.pi))
    ones, zeros = np.ones(len(omega)), np.zeros(len(omega))
    design = np.stack([np.stack([ones, zeros], axis=1), np.stack([zeros, -omega], axis=1)], axis=1)
    normal = np.einsum("bip,bij,bjq->pq", design, weights, design)
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    freedom = 2 * len(omega) - 3

    def at(taus: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Estimates (t, 2) and chi-square (t,)."""
        turned = np.outer(taus, omega)
        left = np.stack([log_gain + 0.5 * np.log1p(turned**2), phase + np.arctan(turned)], axis=2)
        values = np.einsum("pq,biq,bij,tbj->tp", inverse, design, weights, left, optimize=True)
        rest = left - np.einsum("bip,tp->tbi", design, values)
        return values, np.einsum("tbi,bij,tbj->t", rest, weights, rest, optimize=True)

    top = 10.0 / float(omega.min())
    taus = np.concatenate([[0.0], np.geomspace(1e-4 / float(omega.max()), top, TAU_STEPS)])
    _, chi_square = at(taus)
    scale = max(float(chi_square.min()) / freedom, 1.0)
    likely = taus[chi_square < chi_square.min() + 40.0 * scale]
    taus = np.linspace(max(0.0, float(likely.min()) * 0.9), float(likely.max()) * 1.1 + 1e-9, 4 * TAU_STEPS)
    values, chi_square = at(taus)
    weight = np.exp(-0.5 * (chi_square - chi_square.min()) / scale)
    weight /= weight.sum()
    samples = np.column_stack([values, taus])
    mean = weight @ samples
    covariance = np.einsum("t,tp,tq->pq", weight, samples - mean, samples - mean)
    covariance[:2, :2] += inverse * scale
    covariance[1, 1] += clock_standard_uncertainty_s**2
    _, without = at(np.zeros(1))
    lag_seen = float(without[0] - chi_square.min()) / scale > SEEN_CHI_SQUARE
    below = float(taus[min(int(np.searchsorted(np.cumsum(weight), 0.95)), len(taus) - 1)])
    doubt = np.sqrt(np.einsum("ii->i", covariance))
    total = float(covariance[1, 1] + covariance[2, 2] + 2.0 * covariance[1, 2])
    band, above = _half_power(response, math.exp(float(mean[0])), float(doubt[0]))
    return DelayAndLag(
        gain=(math.exp(float(mean[0])), math.exp(float(mean[0])) * float(doubt[0])),
        total_delay_s=(float(mean[1] + mean[2]), math.sqrt(max(total, 0.0))),
        delay_s=(float(mean[1]), float(doubt[1])),
        time_constant_s=(float(mean[2]), float(doubt[2])),
        covariance=covariance,
        separated=lag_seen,
        time_constant_below_s=below,
        bandwidth_hz=band,
        bandwidth_above_hz=above,
        chi_square_ratio=float(chi_square.min()) / freedom,
        words=_words(lag_seen, below, band, float(response.frequency_hz.max())),
    )


def _words(lag_seen: bool, below_s: float, band: tuple[float, float] | None, highest_hz: float) -> str:
    first = (
        "delay and first-order lag are told apart"
        if lag_seen
        else f"delay and lag are not told apart: only their sum is; the lag is below {below_s:.2g} s (95 %)"
    )
    reach = "" if band else f"; the gain stays above -3 dB up to {highest_hz:.3g} Hz, where the sweep ends"
    return first + reach


def _half_power(
    response: FrequencyResponse, gain: float, doubt: float
) -> tuple[tuple[float, float] | None, float]:
    """Where |H| falls through -3 dB, by a parabola in ln |H| over ln f around it; and a bound below it.

    The first band below the level would be too early where bands are noisy: the fall is looked for in a
    running mean, and the parabola runs through all bands near it.
    """
    level = np.log(response.gain / gain / HALF_POWER)
    variance = response.polar_covariance()[:, 0, 0]
    logarithm = np.log(response.frequency_hz)
    surely = np.flatnonzero(level - 1.96 * np.sqrt(variance + doubt**2) <= 0)
    above = float(np.exp(logarithm[max(int(surely[0]) - 1, 0)] if len(surely) else logarithm[-1]))
    smooth = np.convolve(level, np.full(3, 1.0 / 3.0), "valid")
    falls = np.flatnonzero((smooth[:-1] > 0) & (smooth[1:] <= 0))
    if len(falls) == 0:
        return None, above
    crossing = float(logarithm[int(falls[0]) + 1])
    moved = 0.0
    for _ in range(PASSES):
        near = np.abs(logarithm - crossing) < math.log(NEAR_RATIO)
        if near.sum() < MIN_BANDS or logarithm[near].max() <= crossing:
            return None, above
        x, weight = logarithm[near] - crossing, 1.0 / np.sqrt(variance[near])
        powers = np.column_stack([np.ones(len(x)), x, x**2])
        inverse = np.asarray(np.linalg.pinv(powers * weight[:, None]), dtype=np.float64)
        line = inverse @ (level[near] * weight)
        moved = math.hypot(float(np.linalg.norm(inverse[0])), doubt) / abs(float(line[1]))
        crossing -= float(line[0] / line[1])
    frequency = math.exp(crossing)
    return (frequency, frequency * moved), above


def _outliers(left: FloatArray, least: float) -> NDArray[np.bool_]:
    """Samples far from the rest of what the bands leave; NaN is none.

    A large one spoils the bands and with them what is left elsewhere: the largest are taken first.
    """
    away = np.abs(left - np.nanmedian(left))
    sigma = 1.4826 * float(np.nanmedian(away))
    return np.greater(np.nan_to_num(away), max(OUTLIER_SIGMAS * sigma, least, 0.2 * float(np.nanmax(away))))


def _grid(time_s: FloatArray, where: str) -> tuple[float, NDArray[np.intp]]:
    """Sample period and each sample's place on the uniform grid."""
    spacing = np.diff(time_s)
    if len(time_s) < 100 or not np.isfinite(time_s).all() or spacing.min() <= 0:
        raise refused("The record is too short, or its time does not run forward.", where, "record again.")
    period = float(np.median(spacing))
    steps = np.concatenate([[0.0], np.cumsum(np.rint(spacing / period))])
    period = float((time_s[-1] - time_s[0]) / steps[-1])
    off = np.abs(time_s - time_s[0] - period * steps).max() / period
    if off > MAX_JITTER_PERIODS:
        raise refused(
            f"The samples are up to {off:.2g} periods off a uniform grid.", where, "look at the unit's clock."
        )
    return period, steps.astype(np.intp)


def _acted(times: FloatArray, reference_time_s: FloatArray, reference: FloatArray, where: str) -> FloatArray:
    """The reference at the unit's sampling times; rest before and after."""
    spacing = np.diff(reference_time_s)
    if not np.isfinite(reference).all() or float(np.ptp(spacing)) > MAX_JITTER_PERIODS * float(
        spacing.mean()
    ):
        raise refused("The stand's reference has gaps or missing values.", where, "record the sweep again.")
    count = len(reference)
    spectrum = np.fft.rfft(reference)
    spectrum[count // 2 :] = 0.0
    fine = np.fft.irfft(spectrum, n=FINER * count) * FINER
    fine_s = reference_time_s[0] + float(spacing.mean()) / FINER * np.arange(FINER * count)
    return np.asarray(np.interp(times, fine_s, fine), dtype=np.float64)


def _bands(frequency: FloatArray, spectrum: ComplexArray, where: str) -> list[slice]:
    """Bins of each band, from where the sweep begins to where it ends."""
    strength = np.abs(spectrum)
    smooth = np.sqrt(np.convolve(strength**2, np.full(BINS_PER_BAND, 1.0 / BINS_PER_BAND), mode="same"))
    smooth[:2] = 0.0
    excited = (smooth > MIN_EXCITATION * smooth.max()) | (
        smooth * frequency > MIN_EXCITATION * (smooth * frequency).max()
    )
    excited &= (frequency > 0) & (frequency < MAX_NYQUIST_PART * frequency[-1])
    rows = np.flatnonzero(excited)
    bands: list[slice] = []
    first, end = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 0)
    while first + BINS_PER_BAND <= end:
        last = max(first + BINS_PER_BAND, int(np.searchsorted(frequency, BAND_RATIO * frequency[first])))
        if last > end:
            break
        bands.append(slice(first, last))
        first = last
    if len(bands) < MIN_BANDS:
        raise refused(
            f"The sweep excites {len(bands)} bands; {MIN_BANDS} are needed.", where, "sweep longer and wider."
        )
    return bands


def _regress(
    frequency: FloatArray, acted: ComplexArray, answered: ComplexArray
) -> tuple[float, complex, float]:
    """Frequency, H and the variance of H (real and imaginary part together) of one band."""
    power = np.abs(acted) ** 2
    middle = float(power @ frequency / power.sum())
    design = np.column_stack([acted, acted * (frequency - middle)])
    normal = np.asarray(np.linalg.inv(design.conj().T @ design), dtype=np.complex128)
    values = normal @ (design.conj().T @ answered)
    left = answered - design @ values
    freedom = len(frequency) - 2
    variance = float((np.abs(left) ** 2).sum()) / freedom * freedom / (freedom - 1.0)
    floor = (1e-12 * abs(complex(values[0]))) ** 2
    return middle, complex(values[0]), max(variance * float(normal[0, 0].real), floor)


def _predicted(
    frequency: FloatArray, spectrum: ComplexArray, bins: list[tuple[float, complex, float]], count: int
) -> FloatArray:
    """The output that the bands found so far give."""
    middle = np.array([one[0] for one in bins])
    response = np.array([one[1] for one in bins])
    gain = np.interp(frequency, middle, np.abs(response))
    phase = np.interp(frequency, np.append(0.0, middle), np.append(0.0, np.unwrap(np.angle(response))))
    return np.asarray(np.fft.irfft(spectrum * gain * np.exp(1j * phase), n=count), dtype=np.float64)
