# pyright: strict
"""What makes one stand of a kind this one: its errors and the date of its calibration, drawn by its seed.

Each figure has a generator of its own, of kind, seed and name: a new error leaves the others as they were.
"""

import numpy as np
from numpy.typing import NDArray

from dut_emulator.motion.schedule import Triple

MAX_DEVIATIONS = 3.0


class StandDraws:
    """Figures of one stand by name. `kind`: of the stand, such as 'rate_table'."""

    def __init__(self, kind: str, seed: int) -> None:
        self._entropy = (seed % 2**64, *kind.encode())

    def generator(self, name: str) -> np.random.Generator:
        """For this name."""
        return np.random.Generator(np.random.PCG64([*self._entropy, *name.encode()]))

    def normal(self, name: str, deviation: float) -> float:
        """About 0, cut at `MAX_DEVIATIONS`."""
        return deviation * float(cut_normal(self.generator(name), 1)[0])

    def triple(self, name: str, deviation: float) -> Triple:
        """Three axes, each as `normal`."""
        x, y, z = (deviation * float(value) for value in cut_normal(self.generator(name), 3))
        return x, y, z

    def size(self, name: str, most: float) -> float:
        """30 to 100 % of the most, without a sign."""
        return most * float(self.generator(name).uniform(0.3, 1.0))

    def signed(self, name: str, most: float) -> float:
        """As `size`, of either sign."""
        return self.size(name, most) * (1.0 if self.generator(f"{name} sign").random() < 0.5 else -1.0)

    def wave(self, name: str, most: float) -> tuple[float, float]:
        """Cosine and sine amplitude of a wave of any phase."""
        phase = self.generator(f"{name} phase").uniform(0.0, 2 * np.pi)
        size = self.size(name, most)
        return size * float(np.cos(phase)), size * float(np.sin(phase))

    def vector(self, name: str, most: float) -> Triple:
        """Of any direction in space."""
        direction = self.generator(f"{name} direction").standard_normal(3)
        direction *= self.size(name, most) / float(np.linalg.norm(direction))
        x, y, z = (float(part) for part in direction)
        return x, y, z


def cut_normal(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count,) standard normal, cut at `MAX_DEVIATIONS`: a stand's stated spread has no outliers."""
    return np.clip(rng.standard_normal(count), -MAX_DEVIATIONS, MAX_DEVIATIONS)


def calibration_due(kind: str, seed: int) -> str:
    """ISO date until which the stand's own calibration holds: one to two years after recordings' own date.

    Recordings begin at 2026-01-01 unless told another date: a stand is overdue by choice only.
    """
    rng = StandDraws(kind, seed).generator("calibration due")
    return f"2027-{int(rng.integers(1, 13)):02d}-{int(rng.integers(1, 29)):02d}"
