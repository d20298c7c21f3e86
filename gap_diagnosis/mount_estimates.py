# pyright: strict
"""What each mount of a unit says by itself: parameters of given effects, and the recalibrated matrices.

A diagnosis takes one amplitude of an effect for all of a unit's recordings, and projects the matrix of every
mount out. Here both are unknowns of the mount, from the same Gram matrices: a stand's error then shows as a
difference between mounts, and so do constants that no single mount can show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName
from dut_emulator.effects.parameters import scalars
from gap_diagnosis.candidates import Trial
from gap_diagnosis.design import INPUT_SCALE, NUISANCES
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.prepared import MATRIX_PRIOR, Prepared, prepare
from gap_diagnosis.whitened import recording_system

INPUTS = NUISANCES - 1
LEVEL_ROUNDS = 3
"""So often the slow noise's level is weighed anew with the amplitudes found."""
DETERMINED = 1e-6
"""A parameter keeps at least this share of its own information beside all others, or is not told at all."""
MATRIX_TOLD = 0.2
"""A matrix entry is told where its uncertainty is below this share of the recalibration's prior."""


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of one effect at one mount, in the effect's own unit.

    `sensor`: triad; empty: all. `direct`: the samples show it by themselves; it is missing where they do not.
    """

    effect: str
    sensor: str
    name: str
    value: float
    standard_uncertainty: float
    unit: str
    direct: bool = False


@dataclass(frozen=True)
class MatrixEstimate:
    """What a triad's matrix is beyond the believed one, at one mount.

    Attributes:
        change: (3, 3) output axis × input axis.
        covariance: (9, 9) of its rows after each other.
        told: (3, 3) entries that this mount's motion determines.
    """

    sensor: SensorName
    change: FloatArray
    covariance: FloatArray
    told: NDArray[np.bool_]


@dataclass(frozen=True)
class MountEstimate:
    """One mount of one unit on one stand."""

    serial: str
    stand_id: str
    mount: str
    recordings: tuple[str, ...]
    parameters: tuple[ParameterEstimate, ...]
    matrices: tuple[MatrixEstimate, ...]


def mount_estimates(
    observations: Sequence[Observation], trials: Sequence[Trial]
) -> tuple[MountEstimate, ...]:
    """Each mount of the recordings of one unit.

    Args:
        observations: of one unit, as a diagnosis takes them.
        trials: effects with their shapes; all are fitted together.
    """
    prepared = prepare(observations, trials, 0, np.random.default_rng(0), cells=False)
    groups: dict[str, list[int]] = {}
    for index, mount in enumerate(prepared.mounts):
        groups.setdefault(mount, []).append(index)
    found: list[MountEstimate] = []
    for group in groups.values():
        first = observations[group[0]]
        parameters, matrices = _of_group(prepared, group)
        parameters += _direct([observations[i] for i in group])
        found.append(
            MountEstimate(
                first.serial,
                first.stand_id,
                first.mount,
                tuple(observations[i].recording_id for i in group),
                parameters,
                matrices,
            )
        )
    return tuple(found)


def _direct(observations: Sequence[Observation]) -> tuple[ParameterEstimate, ...]:
    """What frames, counter and clocks of a mount show: means, weighted by their uncertainties."""
    found: dict[tuple[str, str, str, str], list[tuple[float, float]]] = {}
    for one in observations:
        for finding in one.timing:
            key = (finding.effect, ", ".join(finding.sensors), finding.parameter, finding.unit)
            found.setdefault(key, []).append((finding.value, finding.standard_uncertainty))
    estimates: list[ParameterEstimate] = []
    for (effect, sensors, name, unit), each in found.items():
        values = np.array(each)
        weight = 1.0 / np.maximum(values[:, 1], 1e-9 * np.abs(values[:, 0]).max() + 1e-300) ** 2
        mean, u = float(weight @ values[:, 0] / weight.sum()), float(weight.sum() ** -0.5)
        estimates.append(ParameterEstimate(effect, sensors, name, mean, u, unit, direct=True))
    return tuple(estimates)


@dataclass(frozen=True)
class _ChannelPart:
    """A channel's normal equations at each level of its slow noise, and the unknowns that they are in.

    Attributes:
        gram, cross: (h, p, p), (h, p), run biases projected out.
        score: (h,) ln of the level's prior and of the likelihood of nought.
        columns, unknowns: (p,) each, which column is which unknown.
    """

    gram: FloatArray
    cross: FloatArray
    score: FloatArray
    columns: NDArray[np.int64]
    unknowns: NDArray[np.int64]


def _of_group(
    prepared: Prepared, group: Sequence[int]
) -> tuple[tuple[ParameterEstimate, ...], tuple[MatrixEstimate, ...]]:
    """All unknowns of one mount together: 3 matrix entries of each channel, then all scalars."""
    channels = [c for c in prepared.moments if any(i in prepared.moments[c] for i in group)]
    scalar_places = [
        (number, k) for number, block in enumerate(prepared.design.blocks) for k in range(len(block.scalars))
    ]
    first = INPUTS * len(channels)
    parts = [_part(prepared, group, channel, n, first, scalar_places) for n, channel in enumerate(channels)]
    size = first + len(scalar_places)
    prior = np.zeros(size)
    for n, channel in enumerate(channels):
        prior[INPUTS * n : INPUTS * (n + 1)] = (MATRIX_PRIOR * INPUT_SCALE[channel.sensor]) ** -2
    amplitude, covariance, information = _solved(parts, size, prior)
    parameters: list[ParameterEstimate] = []
    for place, (number, k) in enumerate(scalar_places, start=first):
        kept = 1.0 / max(covariance[place, place] * information[place], 1e-300)
        if information[place] > 0.0 and kept > DETERMINED:
            variance = float(covariance[place, place])
            parameters.append(_parameter(prepared, number, k, float(amplitude[place]), variance))
    return tuple(parameters), _matrices(channels, amplitude, covariance)


def _part(
    prepared: Prepared,
    group: Sequence[int],
    channel: Channel,
    number: int,
    first: int,
    scalar_places: Sequence[tuple[int, int]],
) -> _ChannelPart:
    noise = prepared.noise[channel]
    gram = cross = likelihood = 0.0
    for index in group:
        if index not in prepared.moments[channel]:
            continue
        one = recording_system(prepared.moments[channel][index], noise.levels, noise.white_si[index])
        gram, cross, likelihood = gram + one[0], cross + one[1][..., 0], likelihood + one[2][..., 0]
    columns, unknowns = list(range(INPUTS)), list(range(INPUTS * number, INPUTS * (number + 1)))
    for place, (block, k) in enumerate(scalar_places, start=first):
        index = prepared.design.blocks[block].columns.get(channel)
        if index is not None and index[k] >= 0:
            columns.append(int(index[k]) - 1)  # the bias is projected out already
            unknowns.append(place)
    chosen = np.array(columns)
    return _ChannelPart(
        np.asarray(gram)[:, chosen][:, :, chosen],
        np.asarray(cross)[:, chosen],
        np.asarray(likelihood) + noise.levels.log_weight,
        chosen,
        np.array(unknowns),
    )


def _solved(
    parts: Sequence[_ChannelPart], size: int, prior: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Amplitudes, covariance and each unknown's own information."""
    amplitude: FloatArray = np.zeros(size)
    covariance: FloatArray = np.zeros((size, size))
    own: FloatArray = np.zeros(size)
    for round_number in range(LEVEL_ROUNDS):
        gram, cross = np.diag(prior), np.zeros(size)
        for part in parts:
            a = amplitude[part.unknowns]
            gained = part.cross @ a - 0.5 * (part.gram @ a) @ a if round_number else 0.0
            score = part.score + gained
            weight = np.exp(score - score.max())
            weight /= weight.sum()
            gram[np.ix_(part.unknowns, part.unknowns)] += np.tensordot(weight, part.gram, 1)
            cross[part.unknowns] += weight @ part.cross
        own = np.diag(gram).copy()
        root = np.sqrt(np.where(own > 0.0, own, 1.0))
        scaled = gram / (root[:, np.newaxis] * root)
        scaled[np.diag_indices(size)] += 1e-9 + (own <= 0.0)
        covariance = np.linalg.inv(scaled) / (root[:, np.newaxis] * root)
        amplitude = covariance @ cross
    return amplitude, covariance, own


def _parameter(prepared: Prepared, number: int, k: int, value: float, variance: float) -> ParameterEstimate:
    design = prepared.design
    block = design.blocks[number]
    name = block.scalars[k]
    channel = next(c for c, columns in block.columns.items() if columns[k] >= 0)
    scale = float(design.channels[channel].scales[int(block.columns[channel][k])])
    effect = next(one for one in block.effects if one.sensor == channel.sensor)
    unit = next(one.unit for one in scalars(effect) if one.name == name)
    sensor = "" if len(block.effects) > 1 else effect.sensor
    trial = design.trials[block.trial].name
    return ParameterEstimate(trial, sensor, name, value / scale, float(np.sqrt(variance)) / scale, unit)


def _matrices(
    channels: Sequence[Channel], amplitude: FloatArray, covariance: FloatArray
) -> tuple[MatrixEstimate, ...]:
    """Of each triad with all three axes and an input."""
    places: dict[SensorName, dict[int, int]] = {}
    for n, channel in enumerate(channels):
        places.setdefault(channel.sensor, {})[channel.axis] = INPUTS * n
    found: list[MatrixEstimate] = []
    sizes: Mapping[str, float] = INPUT_SCALE
    for sensor, by_axis in places.items():
        if sensor not in ("gyro", "acc", "mag") or len(by_axis) != INPUTS:
            continue
        index = np.concatenate([np.arange(by_axis[axis], by_axis[axis] + INPUTS) for axis in range(3)])
        scale = sizes[sensor]
        change = amplitude[index].reshape(3, 3) / scale
        of_change = covariance[np.ix_(index, index)] / scale**2
        uncertainty = np.sqrt(np.diag(of_change)).reshape(3, 3)
        found.append(MatrixEstimate(sensor, change, of_change, uncertainty < MATRIX_TOLD * MATRIX_PRIOR))
    return tuple(found)
