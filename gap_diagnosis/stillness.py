# pyright: strict
"""A unit at rest was acted on by constants: what the stand's report scatters then is its own noise.

Left in, that noise would stand in the residual and in the regressors alike, and every effect of motion would
seem to be there (errors in the regressors). So of a recording at rest all that acted is held constant; of one
that moves, each axis' rate while it is at rest: its noise there looked like a dead band of depth one, since a
dead band alone lives on the smallest rates.
"""

import dataclasses
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import Observation
from gap_diagnosis.rest import at_rest

BLOCK_S = 0.5
FEWEST_ROWS = 8
"""Of a block: fewer do not tell a scatter."""
REST_RAD_S = 1.5e-4
"""Twice the Earth's rate: an axis that reports less, on average, may be at rest. A report that scatters more
tells no rest from a vibration."""
QUIET = 0.1
"""The quantile of the blocks' scatter that is taken for the report's noise."""
ALLOWED = 3.0
"""Times that noise: a block that scatters more was moved."""


def stilled(observation: Observation) -> Observation:
    """With constants for what acted, if the unit was at rest throughout; else for an axis' rate at rest."""
    if not at_rest(observation.outputs):
        return _rests_held(observation)
    stimulus = observation.stimulus
    constant = {
        name: _constant(values)
        for name in ("rate_rad_s", "specific_force_m_s2", "field_t", "angles_rad", "earth_rate_rad_s")
        if (values := getattr(stimulus, name)) is not None
    }
    outputs = {
        sensor: output
        if sensor == "temperature"
        else dataclasses.replace(output, predicted_si=_constant(output.predicted_si))
        for sensor, output in observation.outputs.items()
    }
    return dataclasses.replace(
        observation, stimulus=dataclasses.replace(stimulus, **constant), outputs=outputs
    )


def _constant(values: FloatArray) -> FloatArray:
    """(n, k) each column's mean where it has a value; NaN stays."""
    there = np.isfinite(values)
    count = np.maximum(there.sum(axis=0), 1)
    return np.where(there, np.where(there, values, 0.0).sum(axis=0) / count, np.nan)


def _rests_held(observation: Observation) -> Observation:
    """With each axis' reported rate held where it rests."""
    reported = observation.stimulus.rate_rad_s
    size = round(BLOCK_S / observation.sample_period_s)
    if reported is None or size < FEWEST_ROWS or len(reported) < size:
        return observation
    held = reported.copy()
    for axis in range(3):
        held[:, axis] = _held(reported[:, axis], observation.piece, size)
    stimulus = dataclasses.replace(observation.stimulus, rate_rad_s=held)
    return dataclasses.replace(observation, stimulus=stimulus)


def _held(rate: FloatArray, piece: NDArray[np.int64], size: int) -> FloatArray:
    """(n,) one axis' rate: a rest's mean where it rests, else as reported.

    A rest is a run of blocks of `size` rows. A rate that creeps in one, by its blocks' means, keeps those.
    """
    count = len(rate) // size
    blocks = rate[: count * size].reshape(count, size)
    pieces = piece[: count * size].reshape(count, size)
    whole = np.isfinite(blocks).all(axis=1) & (pieces[:, 0] == pieces[:, -1])
    mean, scatter = blocks.mean(axis=1), blocks.std(axis=1)
    told = whole & (scatter > 0.0)
    if not told.any():
        return rate  # the report has no noise
    noise = float(np.quantile(scatter[told], QUIET))
    if noise > REST_RAD_S:
        return rate
    still = whole & (scatter < ALLOWED * noise) & (np.abs(mean) < REST_RAD_S)
    changes = np.flatnonzero((np.diff(still) != 0) | (pieces[1:, 0] != pieces[:-1, 0])) + 1
    held = rate.copy()
    for first, last in itertools.pairwise([0, *changes, count]):
        if still[first]:
            means = mean[first:last]
            creeps = float(means.std()) > ALLOWED * noise / math.sqrt(size)
            held[first * size : last * size] = np.repeat(
                means if creeps else [means.mean()] * len(means), size
            )
    return held
