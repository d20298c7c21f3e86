# pyright: strict
"""The columns of a diagnosis: a design matrix for each channel of each recording, and who owns which column.

Columns stand in one order for a channel in all recordings: 1 (the bias of the run), the true inputs of the
triad (scale factor and alignment, of the mount), then the regressors of all trials, each scaled to unit rms.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.candidates import Trial
from gap_diagnosis.compared_rows import ComparedRows
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.regimes import Regime, regimes_of

NUISANCES = 4
"""1, and the three inputs of the triad."""
NEGLIGIBLE = 1e-9
"""A regressor below this share of its effect's largest one is nought."""
ROUNDING = 1e-7
INPUT_SCALE = {"gyro": 1.0, "acc": 10.0, "mag": 5e-5, "temperature": 10.0, "gnss": 1.0}


@dataclass(frozen=True)
class Block:
    """Scalars that must be fitted together: those that share a channel.

    Attributes:
        trial: index of the trial.
        effects: of one triad; of a tied trial, one of each triad.
        scalars: free scalars, k of them.
        columns: channel → (k,) index of each scalar's column, -1 where it has no part in the channel.
    """

    trial: int
    effects: tuple[CatalogueEffect, ...]
    scalars: tuple[str, ...]
    columns: Mapping[Channel, NDArray[np.int64]]


@dataclass
class ChannelDesign:
    """Columns of one channel in every recording.

    Attributes:
        matrices: recording index → (n, p) float64; rows are those in `rows`.
        rows: recording index → (n,) bool over the observation's rows.
        scales: (p,) what a column was divided by: a scalar is its column's amplitude over it.
    """

    channel: Channel
    matrices: dict[int, FloatArray] = field(default_factory=dict[int, FloatArray])
    rows: dict[int, NDArray[np.bool_]] = field(default_factory=dict[int, NDArray[np.bool_]])
    scales: FloatArray = field(default_factory=lambda: np.ones(NUISANCES))

    def without_trials(self) -> None:
        """Let go of all columns but the nuisances': what a search needs is in the statistics."""
        self.matrices = {i: matrix[:, :NUISANCES].copy() for i, matrix in self.matrices.items()}


@dataclass(frozen=True)
class CellGroup:
    """All cells of one variable for one channel; `columns` (cells,) are their indicators."""

    channel: Channel
    regime: Regime
    columns: NDArray[np.int64]


@dataclass(frozen=True)
class Design:
    """All columns, and the blocks and cells that own them."""

    trials: tuple[Trial, ...]
    channels: Mapping[Channel, ChannelDesign]
    blocks: tuple[Block, ...]
    cells: tuple[CellGroup, ...] = ()


def channels_of(
    observations: Sequence[Observation], wanted: frozenset[Channel] | None = None
) -> dict[Channel, dict[int, NDArray[np.bool_]]]:
    """Channels (all, or those wanted) with usable rows: recording index → (n,) which."""
    found: dict[Channel, dict[int, NDArray[np.bool_]]] = {}
    for index, one in enumerate(observations):
        for sensor, output in one.outputs.items():
            if output.noise.white_si_per_sqrt_hz is None and sensor == "temperature":
                continue  # a unit is not as warm as its chamber: a gap only where a belief says how far
            for axis in range(1 if sensor == "temperature" else output.values_si.shape[1]):
                if wanted is not None and Channel(sensor, axis) not in wanted:
                    continue
                rows = one.usable & np.isfinite(output.residual_si[:, axis])
                if np.count_nonzero(rows) > 3 * NUISANCES:
                    found.setdefault(Channel(sensor, axis), {})[index] = rows
    return found


def _kept(_part: ChannelDesign) -> None:
    return None


def designed(
    observations: Sequence[Observation],
    trials: Sequence[Trial],
    *,
    cells: bool,
    wanted: frozenset[Channel] | None = None,
    each: Callable[[ChannelDesign], None] = _kept,
) -> Design:
    """Columns for all trials, and for the cells of all regimes where these are wanted.

    A trial that moves nothing, or lacks its stimulus, owns no block. `each` is given every channel as soon as
    its columns stand side by side, and may let go of them before the next one's are made.
    """
    rows = channels_of(observations, wanted)
    compared = [ComparedRows(one) for one in observations]
    parts: dict[Channel, dict[int, list[FloatArray]]] = {
        channel: {
            index: [np.ones(np.count_nonzero(use)), *_inputs(observations[index], channel, use)]
            for index, use in by_recording.items()
        }
        for channel, by_recording in rows.items()
    }
    counts = dict.fromkeys(rows, NUISANCES)
    scales: dict[Channel, list[float]] = {channel: [1.0] * NUISANCES for channel in rows}
    blocks: list[Block] = []
    for number, trial in enumerate(trials):
        for together in (trial.effects,) if trial.tied else tuple((effect,) for effect in trial.effects):
            blocks += _own(number, together, observations, compared, rows, parts, counts, scales)
    groups: list[CellGroup] = []
    channels: dict[Channel, ChannelDesign] = {}
    del compared
    for channel, use in rows.items():
        columns = parts.pop(channel)
        if cells:
            groups += _cells(observations, channel, use, columns, counts, scales[channel])
        matrices = {index: np.stack(columns.pop(index)).T for index in list(columns)}
        channels[channel] = ChannelDesign(channel, matrices, dict(use), np.array(scales[channel]))
        each(channels[channel])
    return Design(tuple(trials), channels, tuple(blocks), tuple(groups))


def _cells(
    observations: Sequence[Observation],
    channel: Channel,
    rows: Mapping[int, NDArray[np.bool_]],
    parts: dict[int, list[FloatArray]],
    counts: dict[Channel, int],
    scales: list[float],
) -> list[CellGroup]:
    """Append the indicators of every regime's cells."""
    groups: list[CellGroup] = []
    for regime in regimes_of(observations, channel):
        count = len(regime.edges) - 1
        for index, use in rows.items():
            inside = regime.indicators(index, use)
            for cell in range(count):
                column = np.zeros(np.count_nonzero(use)) if inside is None else inside[:, cell]
                parts[index].append(column - column.mean())
        scales += [1.0] * count
        told = dataclasses.replace(regime, values=())  # a long record's would stay for nothing
        groups.append(CellGroup(channel, told, np.arange(counts[channel], counts[channel] + count)))
        counts[channel] += count
    return groups


def _inputs(one: Observation, channel: Channel, use: NDArray[np.bool_]) -> list[FloatArray]:
    """The triad's true inputs on the rows used, of order one; nought where the stimulus has none."""
    stimulus = one.stimulus
    values = {
        "gyro": stimulus.rate_rad_s,
        "acc": stimulus.specific_force_m_s2,
        "mag": stimulus.field_t,
        "temperature": None,
        "gnss": None,
    }[channel.sensor]
    if values is None or one.outputs[channel.sensor].norm is not None:  # its matrix is what is looked for
        return [np.zeros(np.count_nonzero(use)) for _ in range(3)]
    return [np.ascontiguousarray(values[use, axis]) / INPUT_SCALE[channel.sensor] for axis in range(3)]


def _own(
    number: int,
    effects: tuple[CatalogueEffect, ...],
    observations: Sequence[Observation],
    compared: Sequence[ComparedRows],
    rows: Mapping[Channel, Mapping[int, NDArray[np.bool_]]],
    parts: dict[Channel, dict[int, list[FloatArray]]],
    counts: dict[Channel, int],
    scales: dict[Channel, list[float]],
) -> list[Block]:
    """Append the columns of effects with common parameters where they are not nought; their blocks."""
    mine = [channel for effect in effects for channel in rows if channel.sensor == effect.sensor]
    said: dict[tuple[SensorName, int], dict[str, FloatArray]] = {}
    for effect in effects:
        for index in sorted(
            {i for channel in mine if channel.sensor == effect.sensor for i in rows[channel]}
        ):
            columns = compared[index].regressors(effect)
            view = observations[index].outputs[effect.sensor].norm
            if columns is not None and view is not None:
                columns = {name: view.column(column) for name, column in columns.items()}
            if columns is not None:
                said[effect.sensor, index] = columns
    names = list(dict.fromkeys(name for columns in said.values() for name in columns))
    deviations = {
        (name, channel): {
            i: _Deviation.of(said[channel.sensor, i][name][compared[i].among(use), channel.axis])
            for i, use in rows[channel].items()
            if (channel.sensor, i) in said
        }
        for name in names
        for channel in mine
    }
    rms = {key: _rms(list(parts_of.values())) for key, parts_of in deviations.items()}
    largest = max(rms.values(), default=0.0)
    if not (np.isfinite(largest) and largest > 0.0):
        return []
    owned: dict[str, dict[Channel, int]] = {}
    for (name, channel), own_size in rms.items():
        if own_size <= NEGLIGIBLE * largest:
            continue
        size = max(rms[name, other] for other in mine)  # one scale for a scalar: it is one number everywhere
        owned.setdefault(name, {})[channel] = counts[channel]
        counts[channel] += 1
        scales[channel].append(size)
        for index, use in rows[channel].items():
            moved = deviations[name, channel].get(index)
            column = np.zeros(np.count_nonzero(use)) if moved is None else moved.values / size
            parts[channel][index].append(column)
    return [_block(number, effects, group, owned) for group in _sharing(owned)]


@dataclass(frozen=True)
class _Deviation:
    """A regressor about its mean in one recording, which the bias of the run takes anyway.

    Attributes:
        values: (n,).
        square: their sum of squares.
        mean: that was taken off.
    """

    values: FloatArray
    square: float
    mean: float

    @staticmethod
    def of(regressor: FloatArray) -> "_Deviation":
        if not len(regressor):
            return _Deviation(regressor, 0.0, 0.0)
        mean = float(regressor.mean())
        values = regressor - mean
        return _Deviation(values, float(values @ values), mean)

    def largest(self) -> float:
        """Of the regressor's absolute values."""
        return float(np.abs(self.values + self.mean).max(initial=0.0))


def _rms(parts: Sequence[_Deviation]) -> float:
    """Of the deviation from each recording's mean; 0 where it is rounding alone."""
    count = sum(len(part.values) for part in parts)
    size = math.sqrt(sum(part.square for part in parts) / max(count, 1))
    at_most = max((abs(part.mean) + math.sqrt(part.square) for part in parts), default=0.0)
    if size > ROUNDING * at_most:
        return size
    return size if size > ROUNDING * max((part.largest() for part in parts), default=0.0) else 0.0


def _sharing(owned: Mapping[str, Mapping[Channel, int]]) -> list[list[str]]:
    """Scalars in groups that share a channel, directly or through others."""
    groups: list[tuple[set[Channel], list[str]]] = []
    for name, channels in owned.items():
        touching = [group for group in groups if group[0] & channels.keys()]
        joined = (set(channels), [name])
        for group in touching:
            joined = (joined[0] | group[0], [*group[1], *joined[1]])
            groups.remove(group)
        groups.append(joined)
    return [sorted(names) for _, names in groups]


def _block(
    number: int,
    effects: tuple[CatalogueEffect, ...],
    names: list[str],
    owned: Mapping[str, Mapping[Channel, int]],
) -> Block:
    channels = sorted({c for name in names for c in owned[name]}, key=lambda c: (c.sensor, c.axis))
    return Block(
        number,
        effects,
        tuple(names),
        {
            channel: np.array([owned[name].get(channel, -1) for name in names], dtype=np.int64)
            for channel in channels
        },
    )
