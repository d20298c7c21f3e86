"""The whitened inner product of a case, with all that is recalibrated at a mount projected out.

Recalibrated: bias of each run, the matrix row of each channel at each mount.
"""

import numpy as np
from numpy.typing import NDArray

from tests.blind.effect_shapes import Block
from tests.blind.excitations import Excitation, Run
from tests.blind.noise import ChannelNoise, InnovationsFilter

Array = NDArray[np.float64]


def stimulus(run: Run, channel: str) -> Array:
    """(fine, 3): what a channel's matrix row multiplies."""
    return {"gyro": run.w, "acc": run.f, "mag": run.m}[channel.split("_")[0]]


class ChannelMetric:
    """Inner products of one channel's columns under its noise."""

    def __init__(self, excitation: Excitation, channel: str, noise: ChannelNoise) -> None:
        self._filter = InnovationsFilter(noise)
        self._slices = excitation.slices()
        nuisances = _nuisances(excitation, channel)
        starts = []
        for part in self._slices:
            initial = self._filter.initial_columns(part.stop - part.start)
            column = np.zeros((excitation.rows, initial.shape[1]))
            column[part] = initial
            starts.append(column)
        self._fixed = np.hstack([self.whitened(nuisances), *starts])
        self._scale = 1 / np.maximum(np.linalg.norm(self._fixed, axis=0), 1e-300)
        prior = np.zeros(self._fixed.shape[1])
        prior[nuisances.shape[1] :] = 1.0
        gram = self._fixed.T @ self._fixed + np.diag(prior)
        values, vectors = np.linalg.eigh(gram * np.outer(self._scale, self._scale))
        keep = values > 1e-10 * values.max()
        self._half = self._scale[:, None] * vectors[:, keep] / np.sqrt(values[keep])

    def whitened(self, columns: Array) -> Array:
        """(rows, m) run by run."""
        return np.concatenate([self._filter(columns[part]) for part in self._slices])

    def explained(self, whitened: Array) -> Array:
        """(r, m): coordinates of whitened columns in what is recalibrated."""
        return self._half.T @ (self._fixed.T @ whitened)

    def residual(self, whitened: Array) -> Array:
        """Whitened columns without what recalibration takes away."""
        return whitened - self._fixed @ (self._half @ self.explained(whitened))

    def inner(self, one: Array, other: Array) -> Array:
        """Projected inner products of whitened columns (rows, p), (rows, q)."""
        return one.T @ other - self.explained(one).T @ self.explained(other)


def _nuisances(excitation: Excitation, channel: str) -> Array:
    columns = []
    for part in excitation.slices():
        bias = np.zeros(excitation.rows)
        bias[part] = 1
        columns.append(bias)
    rows = excitation.stacked(lambda run: stimulus(run, channel))
    mounts = np.concatenate([np.full(run.rows, run.mount) for run in excitation.runs])
    for mount in np.unique(mounts):
        for axis in range(3):
            column = np.where(mounts == mount, rows[:, axis], 0)
            if np.abs(column).max() > 0:
                columns.append(column)
    return np.stack(columns, axis=1)


class Metric:
    """Inner products over all channels."""

    def __init__(self, excitation: Excitation, noise: dict[str, ChannelNoise]) -> None:
        self.channels = {name: ChannelMetric(excitation, name, one) for name, one in noise.items()}

    def gram(self, block: Block) -> Array:
        """(k, k) of a block's columns; channels that the unit does not have count for nothing."""
        total: Array | float = 0.0
        for channel, columns in block.items():
            if channel in self.channels:
                whitened = self.channels[channel].whitened(columns)
                total = total + self.channels[channel].inner(whitened, whitened)
        return np.atleast_2d(total)

    def signal_to_noise(self, signal: dict[str, Array]) -> float:
        """d of a signal, channel to (rows,)."""
        return float(np.sqrt(max(self.gram({c: x[:, None] for c, x in signal.items()})[0, 0], 0)))
