# pyright: strict
"""A lot: what units made together have in common, and what is each one's own.

A parameter of a unit is mean + lot + wafer + unit: three independent normal parts with standard deviations
of their own (the variance components of a nested design). Every part is drawn from a generator that seed,
parameter and lot, wafer or serial number make, so that a unit is the same whichever bench draws it, in
whatever order, and a parameter that is added later leaves the others as they were.
"""

import math
import re
import zlib
from dataclasses import dataclass

import numpy as np

UNITS_PER_WAFER = 24
MAX_DEVIATIONS = 3.0
"""Each part is cut there: a product's stated spread has no outliers; a defect is drawn on purpose."""

_LOT, _WAFER, _UNIT = range(3)
_TRAILING_DIGITS = re.compile(r"(\d{1,15})$")


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the three parts, in the parameter's unit (or of its logarithm)."""

    unit: float = 0.0
    wafer: float = 0.0
    lot: float = 0.0


@dataclass(frozen=True)
class LotDraw:
    """One unit's draws. `seed`: of the lot."""

    seed: int
    serial: str

    @property
    def wafer(self) -> int:
        """The wafer that the unit's sensors come from: serial numbers count through the wafers."""
        digits = _TRAILING_DIGITS.search(self.serial)
        number = int(digits[1]) if digits else zlib.crc32(self.serial.encode())
        return number // UNITS_PER_WAFER

    def normal(self, name: str, mean: float, spread: Spread) -> float:
        """A parameter with normal parts."""
        parts = (
            (spread.lot, (_LOT,)),
            (spread.wafer, (_WAFER, self.wafer)),
            (spread.unit, (_UNIT, *self.serial.encode())),
        )
        return mean + sum(deviation * self._standard(name, key) for deviation, key in parts if deviation)

    def around(self, name: str, median: float, spread: Spread) -> float:
        """A parameter whose logarithm has normal parts: noise levels, resistances."""
        return median * math.exp(self.normal(name, 0.0, spread))

    def triple(self, name: str, mean: float, spread: Spread) -> tuple[float, float, float]:
        """Three axes, each with parts of its own."""
        x, y, z = (self.normal(f"{name}_{axis}", mean, spread) for axis in "xyz")
        return x, y, z

    def triple_around(self, name: str, median: float, spread: Spread) -> tuple[float, float, float]:
        """Three axes of a log-normal parameter."""
        x, y, z = (self.around(f"{name}_{axis}", median, spread) for axis in "xyz")
        return x, y, z

    def happens(self, name: str, probability: float) -> bool:
        """Whether this unit has a defect of this rate."""
        return float(self._generator(f"defect {name}", (_UNIT, *self.serial.encode())).random()) < probability

    def index(self, name: str, count: int) -> int:
        """One of `count` places, drawn for this unit."""
        return int(self._generator(f"place {name}", (_UNIT, *self.serial.encode())).integers(count))

    def seed_for(self, *purpose: int) -> np.random.SeedSequence:
        """The seed of one of the unit's random processes; different purposes are independent."""
        return np.random.SeedSequence([self.seed % 2**64, *self.serial.encode()], spawn_key=purpose)

    def _standard(self, name: str, key: tuple[int, ...]) -> float:
        value = float(self._generator(name, key).standard_normal())
        return min(max(value, -MAX_DEVIATIONS), MAX_DEVIATIONS)

    def _generator(self, name: str, key: tuple[int, ...]) -> np.random.Generator:
        seed = np.random.SeedSequence([self.seed % 2**64, *name.encode()], spawn_key=key)
        return np.random.Generator(np.random.PCG64(seed))
