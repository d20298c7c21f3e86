# pyright: strict
"""From observations to what a search works on: columns, noise levels, statistics with simulated nulls."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.candidates import Trial
from gap_diagnosis.design import INPUT_SCALE, NUISANCES, ChannelDesign, Design, designed
from gap_diagnosis.noise_model import Knots, Levels, knots_for, levels_of, shapes_for, white_noise_of_rows
from gap_diagnosis.observation import Channel, NoiseBelief, Observation
from gap_diagnosis.reference_noise import is_reference, reference_density
from gap_diagnosis.whitened import ChannelSystem, NullNoise, RecordingMoments, channel_system, moments

SMALLEST_WHITE = 1e-12
MATRIX_PRIOR = 0.05
"""Standard deviation of what a recalibration changes in a scale factor or an alignment."""


@dataclass(frozen=True)
class ChannelNoise:
    """What is found and believed of a channel's noise.

    Attributes:
        white_si: recording → standard deviation of the white noise of a row.
        belief: of the triad.
        log_white_ratio: ln of found over believed density; None where nothing is believed.
        levels: of the slow noise, SI.
        knots: recording → its knots.
        nulls: slow noise of each simulated null.
        null_log_white_ratios: (j,).
    """

    white_si: Mapping[int, float]
    belief: NoiseBelief
    log_white_ratio: float | None
    levels: Levels
    knots: Mapping[int, Knots]
    nulls: NullNoise
    null_log_white_ratios: FloatArray


@dataclass(frozen=True)
class Prepared:
    """Everything that the searches share.

    Attributes:
        observations: as given.
        design: columns and blocks.
        noise: by channel.
        moments: channel → recording → statistics.
        found: systems over all recordings, once somebody has asked for them; of these `moments` and `noise`,
            whatever blocks the design offers.
    """

    observations: tuple[Observation, ...]
    design: Design
    noise: Mapping[Channel, ChannelNoise]
    moments: Mapping[Channel, Mapping[int, RecordingMoments]]
    found: dict[Channel, ChannelSystem] = field(default_factory=dict[Channel, ChannelSystem], repr=False)

    @property
    def mounts(self) -> tuple[str, ...]:
        """Of each recording: a mount 'm1' on another stand is another mount."""
        return tuple(
            f"{one.stand_id}/{one.mount}" if one.mount else one.recording_id for one in self.observations
        )

    def systems(self, recordings: Sequence[int] | None = None) -> dict[Channel, ChannelSystem]:
        """The channels' systems over all recordings, or over some."""
        if recordings is None:
            if not self.found:
                self.found.update(self._systems(None))
            return dict(self.found)
        return self._systems(recordings)

    def forget_nulls_and_cells(self) -> None:
        """Let go of what only localisation looks at: a search goes through what is left many times."""
        for channel, system in self.systems().items():
            ends = [int(group.columns[0]) for group in self.design.cells if group.channel == channel]
            of_trials = min(ends, default=system.gram.shape[1] + NUISANCES) - NUISANCES
            self.found[channel] = system.of_data(of_trials)

    def _systems(self, recordings: Sequence[int] | None) -> dict[Channel, ChannelSystem]:
        found: dict[Channel, ChannelSystem] = {}
        for channel, by_recording in self.moments.items():
            chosen = {i: m for i, m in by_recording.items() if recordings is None or i in recordings}
            if not chosen:
                continue
            noise = self.noise[channel]
            prior_si = MATRIX_PRIOR * INPUT_SCALE[channel.sensor]
            found[channel] = channel_system(chosen, self.mounts, noise.white_si, noise.levels, prior_si)
        return found


def prepare(
    observations: Sequence[Observation],
    trials: Sequence[Trial],
    nulls: int,
    rng: np.random.Generator,
    *,
    cells: bool = True,
    known_noise: Mapping[Channel, ChannelNoise] | None = None,
    wanted: frozenset[Channel] | None = None,
    keep_columns: bool = True,
) -> Prepared:
    """Columns, noise and statistics. `nulls` simulated ones beside the data.

    `known_noise`: of an earlier preparation of the same observations; `wanted`: only these channels.
    `keep_columns`: or only those of the nuisances, since a long record's fill the memory.
    """
    longest_s = max(float(np.ptp(one.stimulus.time_s)) for one in observations)
    noise: dict[Channel, ChannelNoise] = {}
    statistics: dict[Channel, dict[int, RecordingMoments]] = {}

    def weigh(part: ChannelDesign) -> None:
        channel = part.channel
        residuals = {
            i: observations[i].outputs[channel.sensor].residual_si[rows, channel.axis]
            for i, rows in part.rows.items()
        }
        if known_noise is None:
            quiet = {
                i: _recalibrated(residual, _with_delay(observations[i], channel, part, i))
                for i, residual in residuals.items()
            }
            noise[channel] = _noise_of(observations, channel, quiet, part.rows, longest_s, nulls, rng)
        else:
            noise[channel] = known_noise[channel]
        statistics[channel] = {
            i: moments(
                part.matrices[i],
                residual,
                noise[channel].knots[i],
                noise[channel].white_si[i],
                NullNoise(noise[channel].nulls.level_si[:nulls], noise[channel].nulls.shape),
                rng,
            )
            for i, residual in residuals.items()
        }
        if not keep_columns:
            part.without_trials()

    design = designed(observations, trials, cells=cells, wanted=wanted, each=weigh)
    return Prepared(tuple(observations), design, noise, statistics)


def _with_delay(one: Observation, channel: Channel, part: ChannelDesign, recording: int) -> FloatArray:
    """(n, k) bias and matrix; beside a reference the motion's slope too, as a delay is no noise."""
    nuisances = part.matrices[recording][:, :NUISANCES]
    if not is_reference(one):
        return nuisances
    predicted = one.outputs[channel.sensor].predicted_si[part.rows[recording], channel.axis]
    slope = np.gradient(predicted)
    return np.column_stack([nuisances, slope / max(float(np.abs(slope).max()), 1e-300)])


def _recalibrated(residual: FloatArray, matrix: FloatArray) -> FloatArray:
    """What nuisances (n, k) leave, by plain least squares: enough to see the white noise."""
    nuisances = matrix
    gram = nuisances.T @ nuisances
    gram[np.diag_indices_from(gram)] += 1e-9 * (1.0 + np.diag(gram))
    return residual - nuisances @ np.linalg.solve(gram, nuisances.T @ residual)


def _noise_of(
    observations: Sequence[Observation],
    channel: Channel,
    residuals: Mapping[int, FloatArray],
    rows: Mapping[int, NDArray[np.bool_]],
    longest_s: float,
    nulls: int,
    rng: np.random.Generator,
) -> ChannelNoise:
    """One density for all recordings; the quantiser's part is taken off before comparing with the belief.

    nulls: how many. A belief does not say how far a unit's axes go together: each draws levels of its own.
    With half of the spread in common, one emulated triad in ten (axes drawn apart) seemed beyond its spread.
    """
    draws = rng.standard_normal((2, nulls))  # slow level and white level
    first = next(iter(residuals))
    output = observations[first].outputs[channel.sensor]
    belief = output.noise
    periods = {i: observations[i].stimulus.sample_period_s for i in residuals}
    found = {i: white_noise_of_rows(residual) for i, residual in residuals.items()}
    by_reference = [i for i in residuals if is_reference(observations[i])]
    for i in by_reference:
        told = reference_density(residuals[i], observations[i].piece[rows[i]], periods[i])
        found[i] = max(found[i], told / math.sqrt(periods[i]))
    seen_by_norm = {
        i: view.noise_si
        for i in residuals
        if (view := observations[i].outputs[channel.sensor].norm) is not None
    }
    found |= seen_by_norm
    total = sum(len(residual) for residual in residuals.values())
    density = math.sqrt(sum(found[i] ** 2 * periods[i] * len(r) for i, r in residuals.items()) / total)
    density = max(density, SMALLEST_WHITE)
    white = {i: density / math.sqrt(period) for i, period in periods.items()}
    ratio = None
    if belief.white_si_per_sqrt_hz and not by_reference and not seen_by_norm:
        period = observations[first].sample_period_s
        rounding = output.quantum_si**2 / 12.0 * period
        ratio = 0.5 * math.log(max(density**2 - rounding, 1e-4 * density**2) / belief.white_si_per_sqrt_hz**2)
    shapes = shapes_for(belief, longest_s, max(periods.values()))
    shape = shapes[0]
    levels = levels_of(shapes, next(iter(white.values())))
    if shape.level_si is None:
        null_levels = rng.choice(levels.level_si, size=nulls)
    else:
        null_levels = shape.level_si * np.exp(shape.spread * draws[0])
    knots = {
        i: knots_for(observations[i].stimulus.time_s[use], shapes) for i, use in rows.items() if use.any()
    }
    null_ratios = belief.white_spread * draws[1]
    return ChannelNoise(white, belief, ratio, levels, knots, NullNoise(null_levels), null_ratios)
