# pyright: strict
"""What a product is to whoever records one of its units."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray
from dut_emulator.motion.run import Run
from dut_emulator.twin import Twin


@dataclass(frozen=True)
class StreamShape:
    """A stream that a unit sends: columns with units and types, the time first.

    Attributes:
        name: 'dut' for the main one.
        clock: 'dut', unless the stream has a clock of its own.
        units: column → unit of measure; the time column is 't'.
        types: column → numpy type as it is sent: integers stay integers.
    """

    name: str
    units: Mapping[str, str]
    types: Mapping[str, str]
    clock: str = "dut"


@dataclass(frozen=True)
class Mounting:
    """Which stand a profile of this product runs on, and at what rate the unit then samples."""

    stand: str
    rate_hz: float


@dataclass(frozen=True)
class UnitOnStand:
    """A unit put on a stand for one run.

    Attributes:
        twin: the unit's effects.
        stand_effects: the stand's own; one that the twin has too is the twin's.
        run: what the stand does.
        rate_hz: of the main stream.
        seed: of this run's noise: the turn-on, the samples.
        serial: who it is.
        power_on_s: when it was powered, on the run's clock; 0 or before.
    """

    twin: Twin
    stand_effects: tuple[CatalogueEffect, ...]
    run: Run
    rate_hz: float
    seed: np.random.SeedSequence
    serial: str
    power_on_s: float = 0.0


class UnitStreams(Protocol):
    """A unit that is recorded. Asked in steps of any length, it gives the same samples."""

    @property
    def shapes(self) -> tuple[StreamShape, ...]:
        """The streams it sends in this run; the main one first."""
        ...

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """Stream → column → samples of (last advance, to_s]; the first sample of all is at 0 s."""
        ...


class Product(Protocol):
    """One of the products."""

    @property
    def name(self) -> str:
        """As in design and twin files, such as 'mems_ahrs'."""
        ...

    @property
    def profiles(self) -> Mapping[str, Mounting]:
        """Profile → where it is run: every profile that a unit of this product can undergo."""
        ...

    def twin(self, seed: int, serial: str) -> Twin:
        """The unit of this serial number in the lot of this seed: its true effects."""
        ...

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """What is wrong with the drawn unit, by the names of the product's table; empty for a good one."""
        ...

    def believed(self, twin: Twin) -> dict[str, Any]:
        """The `believed` object of a recording: what the simulator knows of a unit with this twin.

        Only what the format can say (matrix, bias, noise, quantum, range, bandwidth): everything else that
        the twin has is what a gap diagnosis may find.
        """
        ...

    def begin(self, unit: UnitOnStand) -> UnitStreams:
        """Power the unit on this stand.

        Raises:
            TestloomError: the twin has an effect that this product cannot have.
        """
        ...


def chain_effects(
    twin: Twin, stand_effects: tuple[CatalogueEffect, ...], sensor: str
) -> tuple[CatalogueEffect, ...]:
    """The effects of one triad: the stand's first, then the unit's; of two with one name the twin's."""
    own = {(effect.sensor, effect.origin, effect.word) for effect in twin.effects}
    return (
        *(
            effect
            for effect in stand_effects
            if effect.sensor == sensor and (effect.sensor, effect.origin, effect.word) not in own
        ),
        *(effect for effect in twin.effects if effect.sensor == sensor),
    )


def sample_times_s(first: int, to_s: float, rate_hz: float) -> FloatArray:
    """Instants k / rate for k = first … that are not after `to_s`: (n,). Exact, whatever the steps."""
    last = int(np.floor(to_s * rate_hz * (1 + 1e-15) + 1e-9))
    return np.arange(first, last + 1, dtype=np.float64) / rate_hz
