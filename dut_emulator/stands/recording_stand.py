# pyright: strict
"""What a stand is to whoever records a unit on it, and to whoever serves it on a bench."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.interfaces import StandModel, Surroundings, TriggerLine
from dut_emulator.motion.run import Run
from protocol.errors import Fault, TestloomError


@dataclass(frozen=True)
class StandIdentity:
    """Which stand it is. `calibration_due`: ISO date until which its own calibration holds."""

    kind: str
    stand_id: str
    calibration_due: str


class RecordingStand(Protocol):
    """A stand with its own errors, ready to run profiles."""

    @property
    def identity(self) -> StandIdentity:
        """Which stand it is."""
        ...

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Its own errors as they act on each triad it carries ('stand.…' of the catalogue)."""
        ...

    def run(self, profile: str, values: Mapping[str, float]) -> Run:
        """One run of a profile.

        Args:
            profile: one that this kind of stand can do.
            values: all of the profile's parameters.

        Raises:
            TestloomError: beyond the stand's limits (rate, acceleration, travel, temperature); says which
                limit, by how much, and what would fit. Nothing has moved.
        """
        ...


@runtime_checkable
class CarriesUnitsInSeveralWays(Protocol):
    """A stand whose axes have other names when a profile's values mount a unit in another way."""

    def effects_of(self, values: Mapping[str, float]) -> tuple[CatalogueEffect, ...]:
        """Its `effects` when a unit is mounted like this: the same list, the same errors."""
        ...


@dataclass(frozen=True)
class LiveStand:
    """A stand on a bench: its command port with the stream, where the unit sits, the line it triggers on.

    `trigger_line` is None where nothing on the bench listens to it.
    """

    port: StandModel
    surroundings: Surroundings
    trigger_line: TriggerLine | None = None


def beyond_limit(stand: str, what: str, remedy: str) -> TestloomError:
    """A profile asks more than a stand can do."""
    return TestloomError(what, where=f"stand {stand}", fault=Fault.OPERATOR, remedy=remedy)
