# pyright: strict
"""What the report's page draws: residuals over time, their Allan deviation and spectrum, before and after."""

import math
from collections.abc import Mapping

import numpy as np

from calibration.algorithms.allan_variance import overlapping_allan_deviation
from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES
from gap_diagnosis.field_units import field_unit
from gap_diagnosis.fitting import JointFit
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.report import ResidualSeries, Spectrum

MAX_CHANNELS = 4
MAX_POINTS = 1200
SEGMENTS = 8
LEAST_ROWS = 256
SI = {"gyro": "rad/s", "acc": "m/s^2", "mag": "T", "temperature": "degC", "gnss": "m"}


def drawn(
    prepared: Prepared, fit: JointFit | None, channels: tuple[Channel, ...]
) -> tuple[tuple[ResidualSeries, ...], tuple[Spectrum, ...]]:
    """Series and spectra of the channels that matter most, from the recording that shows them best."""
    series: list[ResidualSeries] = []
    spectra: list[Spectrum] = []
    for channel in channels[:MAX_CHANNELS]:
        if channel not in prepared.design.channels:
            continue
        added = _added(fit, channel)
        index = _telling(prepared, channel, added)
        before, after, time_s = _residuals(prepared, channel, index, added.get(index))
        factor, unit = field_unit(SI[channel.sensor], float(np.abs(before).max(initial=0.0)))
        recording = prepared.observations[index].recording_id
        thin = max(1, math.ceil(len(before) / MAX_POINTS))
        series.append(
            ResidualSeries(
                recording,
                channel.name,
                unit,
                _means(time_s, thin),
                _means(before, thin) * factor,
                _means(after, thin) * factor,
            )
        )
        if len(before) >= LEAST_ROWS:
            spectra += _spectra(prepared, channel, index, before * factor, after * factor, unit, factor)
    return tuple(series), tuple(spectra)


def _added(fit: JointFit | None, channel: Channel) -> dict[int, FloatArray]:
    """Recording → what the set adds to the channel, SI."""
    if fit is None or channel not in fit.prepared.design.channels:
        return {}
    design = fit.prepared.design
    columns: list[int] = []
    amplitudes: list[float] = []
    for place, amplitude in zip(fit.places, fit.amplitude, strict=True):
        _, block, k = place
        index = design.blocks[block].columns.get(channel)
        if index is not None and index[k] >= 0:
            columns.append(int(index[k]))
            amplitudes.append(float(amplitude))
    return {
        i: matrix[:, columns] @ np.array(amplitudes)
        for i, matrix in design.channels[channel].matrices.items()
    }


def _telling(prepared: Prepared, channel: Channel, added: Mapping[int, FloatArray]) -> int:
    recordings = prepared.design.channels[channel].matrices
    return max(recordings, key=lambda i: float(np.std(added[i])) if i in added and len(added[i]) else 0.0)


def _residuals(
    prepared: Prepared, channel: Channel, index: int, added: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Recalibrated residual before and after, SI, and its times."""
    design = prepared.design.channels[channel]
    one, use = prepared.observations[index], design.rows[index]
    residual = one.outputs[channel.sensor].residual_si[use, channel.axis]
    nuisances = design.matrices[index][:, :NUISANCES]
    before = _without(nuisances, residual)
    after = before if added is None else _without(nuisances, residual - added)
    return before, after, one.stimulus.time_s[use]


def _without(nuisances: FloatArray, values: FloatArray) -> FloatArray:
    gram = nuisances.T @ nuisances
    gram[np.diag_indices_from(gram)] += 1e-9 * (1.0 + np.diag(gram))
    return values - nuisances @ np.linalg.solve(gram, nuisances.T @ values)


def _means(values: FloatArray, count: int) -> FloatArray:
    whole = len(values) // count * count
    return values[:whole].reshape(-1, count).mean(axis=1)


def _spectra(
    prepared: Prepared,
    channel: Channel,
    index: int,
    before: FloatArray,
    after: FloatArray,
    unit: str,
    factor: float,
) -> list[Spectrum]:
    """Allan deviation and density, with what the belief says of both."""
    period_s = prepared.observations[index].stimulus.sample_period_s
    belief = prepared.noise[channel].belief
    white = (belief.white_si_per_sqrt_hz or 0.0) * factor
    slow = (belief.slow_deviation_si or 0.0) * factor
    tau = belief.slow_correlation_time_s or 1.0
    of_before = overlapping_allan_deviation(np.ascontiguousarray(before), 1.0 / period_s)
    of_after = overlapping_allan_deviation(np.ascontiguousarray(after), 1.0 / period_s)
    x = of_before.tau_s / tau
    correlated = 2.0 * slow**2 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))
    flicker = 0.4405 * ((belief.slow_coefficient_si or 0.0) * factor) ** 2  # 2 ln 2 / π
    believed = np.sqrt(white**2 / of_before.tau_s + np.maximum(correlated, 0.0) + flicker)
    frequency, density_before = _density(before, period_s)
    _, density_after = _density(after, period_s)
    believed_density = np.sqrt(
        2.0 * (white**2 + 2.0 * slow**2 * tau / (1.0 + (2.0 * math.pi * frequency * tau) ** 2))
    )
    return [
        Spectrum(
            channel.name, "allan", unit, of_before.tau_s, of_before.deviation, of_after.deviation, believed
        ),
        Spectrum(
            channel.name,
            "psd",
            f"{unit}/sqrt(Hz)",
            frequency,
            density_before,
            density_after,
            believed_density,
        ),
    ]


def _density(values: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray]:
    """One-sided amplitude density over frequency: mean of half-overlapping Hann segments (Welch)."""
    length = max(64, 2 * (len(values) // SEGMENTS) // 2)
    window = np.hanning(length)
    starts = range(0, len(values) - length + 1, max(1, length // 2))
    power = np.mean([np.abs(np.fft.rfft(values[s : s + length] * window)) ** 2 for s in starts], axis=0)
    density = 2.0 * power * period_s / float(np.sum(window**2))
    frequency = np.fft.rfftfreq(length, period_s)
    return frequency[1:].astype(np.float64), np.sqrt(density[1:])
