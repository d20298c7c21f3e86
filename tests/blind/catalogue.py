"""All columns that the oracle knows for one excitation, and their projected Gram matrix in one case."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.effect_shapes import CHANNELS, SHAPES, THRESHOLDS, Block
from tests.blind.excitations import Excitation
from tests.blind.metric import Metric

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Option:
    """One way an effect can act: its phi and the columns that then have coefficients."""

    effect: str
    phi: float
    columns: tuple[int, ...]
    weight: float
    """Prior share of this option within its effect."""


class Catalogue:
    """Columns of every effect (or of those in `only`) that an excitation can move at all."""

    def __init__(self, excitation: Excitation, only: tuple[str, ...] | None = None) -> None:
        self.options: list[Option] = []
        self.effects: list[str] = []
        self._columns: dict[str, list[Array]] = {channel: [] for channel in CHANNELS}
        self._members: dict[str, list[int]] = {channel: [] for channel in CHANNELS}
        self._limits: list[float] = []
        self.size = 0
        self._magnetometer = excitation.magnetometer
        for name, shape in SHAPES.items():
            if not applies(excitation, name) or not (only is None or name in only):
                continue
            grid = [(phi, shape.blocks(excitation, phi)) for phi in shape.grid]
            self._add(name, grid, whole=shape.whole)
        for name, (blocks, grid) in THRESHOLDS.items() if only is None else ():
            values = grid if name == "gyro.dead_band" else [x * largest_rate(excitation) for x in grid]
            self._add(name, [(phi, blocks(excitation, phi)) for phi in values], whole=False)
        self._stacked = {c: np.column_stack(x) for c, x in self._columns.items() if x}
        self._columns.clear()

    def _add(self, name: str, grid: list[tuple[float, list[Block]]], *, whole: bool) -> None:
        added: list[Option] = []
        for phi, blocks in grid:
            taken = [columns for columns in (self._take(block) for block in blocks) if columns]
            if not taken:
                continue
            every = tuple(index for columns in taken for index in columns)
            if whole or len(taken) == 1:
                added.append(Option(name, phi, every, 1.0))
            else:
                added += [Option(name, phi, columns, 0.6 / len(taken)) for columns in taken]
                added.append(Option(name, phi, every, 0.4))
        total = sum(option.weight for option in added)
        self.options += [Option(o.effect, o.phi, o.columns, o.weight / total) for o in added]
        if added:
            self.effects.append(name)

    def _take(self, block: Block) -> tuple[int, ...]:
        """Indices of a block's columns; none where the excitation does not move them."""
        k = next(iter(block.values())).shape[1]
        used = {c: x for c, x in block.items() if self._magnetometer or not c.startswith("mag")}
        alive = [j for j in range(k) if any(np.ptp(x[:, j]) > 1e-9 for x in used.values())]
        indices = tuple(range(self.size, self.size + len(alive)))
        for channel, columns in used.items():
            for index, j in zip(indices, alive, strict=True):
                self._columns[channel].append(columns[:, j])
                self._members[channel].append(index)
        self.size += len(alive)
        return indices

    def gram(self, metric: Metric, signals: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Projected Gram matrices: columns with columns, with signals (rows, s), signals with signals."""
        count = next(iter(signals.values())).shape[1]
        among, across, own = (
            np.zeros((self.size, self.size)),
            np.zeros((self.size, count)),
            np.zeros((count, count)),
        )
        for channel, inner in metric.channels.items():
            signal = inner.whitened(
                signals.get(channel, np.zeros((len(next(iter(signals.values()))), count)))
            )
            own += inner.inner(signal, signal)
            if channel in self._stacked:
                members = self._members[channel]
                columns = inner.whitened(self._stacked[channel])
                raw = np.einsum("ij,ij->j", columns, columns)
                both = np.hstack([columns, signal])
                product = inner.inner(columns, both)
                # what recalibration takes away whole leaves rounding errors only
                gone = np.diag(product) < 1e-7 * raw
                product[gone] = 0
                product[:, : len(gone)][:, gone] = 0
                among[np.ix_(members, members)] += product[:, : len(gone)]
                across[members] += product[:, len(gone) :]
        return among, across, own


def applies(excitation: Excitation, name: str) -> bool:
    """Whether the unit has the channels in which an effect shows, and the stand what moves it."""
    if name.startswith("mag.") or name == "gyro.magnetic_sensitivity":
        return excitation.magnetometer
    if name == "gyro.supply_sensitivity":
        return excitation.supply
    if name == "acc.shock_bias_shift":
        return excitation.runs[0].shock_s is not None
    return True


def largest_rate(excitation: Excitation) -> float:
    """Of all axes and runs, deg/s."""
    return max(float(np.abs(run.w).max()) for run in excitation.runs)


def projection(gram: Array, across: Array, option: Option) -> tuple[int, float, Array]:
    """(rank, squared length, coefficients) of a signal's part in an option's columns; rank by eigenvalues."""
    index = np.array(option.columns)
    block = gram[np.ix_(index, index)]
    scale = 1 / np.sqrt(np.maximum(np.diag(block), 1e-300)) * (np.diag(block) > 0)
    values, vectors = np.linalg.eigh(block * np.outer(scale, scale))
    keep = values > 1e-6
    if not keep.any():
        return 0, 0.0, np.zeros(len(index))
    half = scale[:, None] * vectors[:, keep] / np.sqrt(values[keep])
    along = half.T @ across[index]
    return int(keep.sum()), float(along @ along), half @ along
