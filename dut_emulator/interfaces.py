"""What the server asks of an emulated unit and an emulated stand. Both are pure: time comes in.

The server owns the clock and the sockets; units and stands are state machines over bench time.
"""

from dataclasses import dataclass
from itertools import cycle
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus

CAN_BYTES = 8
"""Of a CAN frame's data, at most."""


class BenchModelError(Exception):
    """A hand's mistake: a second unit in a socket, a fault that a stand cannot have. The text says which."""


class TriggerLine(Protocol):
    """The line between a stand and whatever has to know when something happened."""

    def next_edge_s(self, after_s: float) -> float | None:
        """Bench time of the first edge after a moment; None if none is to come as things stand."""
        ...


class Surroundings(Protocol):
    """Where a unit sits: a level socket board, or a stand's table."""

    def stimulus(self, times_s: NDArray[np.float64]) -> Stimulus:
        """What acts on the unit at these bench times (n,), non-decreasing, up to now.

        `sample_period_s` is left open (NaN): the unit knows how it samples.
        """
        ...

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """The stand's own errors as they act on each triad; the unit's chains begin with them."""
        ...


@dataclass(frozen=True)
class LinkOutput:
    """Bytes, one CAN frame or a burst of them, that leave a unit at a bench time.

    A burst's frames have `CAN_BYTES` each, one after the other in `data`, with `burst_ids` in turn: those of
    a stream are too many for an object each where nobody listens.
    """

    time_s: float
    link: str  # 'rs422' or 'can'
    data: bytes
    can_id: int | None = None
    burst_ids: tuple[int, ...] = ()

    def frames(self) -> list["LinkOutput"]:
        """A burst frame by frame; anything else as it is."""
        if not self.burst_ids:
            return [self]
        pieces = [self.data[at : at + CAN_BYTES] for at in range(0, len(self.data), CAN_BYTES)]
        return [
            LinkOutput(self.time_s, self.link, piece, identifier)
            for piece, identifier in zip(pieces, cycle(self.burst_ids), strict=False)
        ]


class EmulatedUnit(Protocol):
    """A unit in a socket. Every method gets the bench time; calls never go back in time."""

    def insert(self, surroundings: Surroundings, now_s: float) -> None:
        """The unit is put into a socket, unpowered."""
        ...

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins; below the brown-out voltage the unit is off and forgets."""
        ...

    def receive(self, link: str, data: bytes, now_s: float, can_id: int | None = None) -> None:
        """Bytes on RS-422, or one CAN frame, arrive."""
        ...

    def next_event_s(self) -> float | None:
        """When the unit will next do something by itself (an answer due, a stream's samples)."""
        ...

    def advance(self, to_s: float) -> list[LinkOutput]:
        """Everything that leaves the unit in (last advance, to_s], in order of time.

        Stream samples come in blocks, not one by one: a block's time is that of its last sample.
        """
        ...

    def supply_current_a(self, now_s: float) -> float:
        """True current drawn at the present supply voltage."""
        ...

    def resistance_ohm(self, high: str, low: str) -> float:
        """True resistance between two test points, unpowered; inf when open."""
        ...

    def point_voltage_v(self, point: str, now_s: float) -> float:
        """True DC voltage of a test point against GND_1."""
        ...

    def point_ripple_v(self, point: str, now_s: float) -> float:
        """True peak-to-peak AC voltage of a test point."""
        ...

    def point_period_s(self, point: str, now_s: float) -> float | None:
        """True period of a square wave at a test point; None when there is none."""
        ...

    def set_ad_source(self, source: str, voltage_v: float) -> None:
        """The board's AD switch routes this source to its channel."""
        ...

    def flash_image(self) -> dict[str, Any]:
        """What the unit keeps without power, JSON-able: the third argument of `make_unit`."""
        ...


@dataclass(frozen=True)
class StandRefusal:
    """Why a stand does not do what it was told: the `ERR code text` of docs/stands.md."""

    code: int
    text: str


@dataclass(frozen=True)
class StandStatus:
    """What `STAT?` says. Angles and rates are outer, middle, inner."""

    state: str  # READY MOVING FAULT NOREF
    angles_deg: tuple[float, float, float]
    rates_deg_s: tuple[float, float, float]
    temperature_c: float


class EmulatedStand(Surroundings, Protocol):
    """A three-axis turntable. Every command gets the bench time; calls never go back in time.

    A command returns the time it will take in s, or a refusal and nothing has changed.
    """

    def home(self, now_s: float) -> float | StandRefusal:
        """Find the reference marks and go to zero angles."""
        ...

    def move(self, angles_deg: tuple[float, float, float], now_s: float) -> float | StandRefusal:
        """Go to absolute angles (whole turns count) at the positioning rate, all axes at once."""
        ...

    def rotate(
        self, axis: str, angle_deg: float, duration_s: float, ramp_s: float, now_s: float
    ) -> float | StandRefusal:
        """Turn one axis ('outer', 'middle', 'inner') on a trapezoid of rate with equal ramps."""
        ...

    def stop(self, now_s: float) -> float:
        """To rest at the acceleration limit."""
        ...

    def inject(self, fault: str, now_s: float) -> None:
        """'door_open', 'lost_reference' or 'none'."""
        ...

    def status(self, now_s: float) -> StandStatus:
        """The state now."""
        ...

    def limits(self) -> tuple[float, float, float, float, float, float]:
        """Rates (deg/s) and accelerations (deg/s²) of outer, middle, inner."""
        ...

    def encoder_samples(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The stand's own reading at these times (n,), up to now: (n, 15), `protocol.stand_stream`."""
        ...


class StandModel(Protocol):
    """A motion stand as the bench sees it: commands in, samples out, faults for tests."""

    @property
    def sample_bytes(self) -> int:
        """Size of one sample of its stream."""
        ...

    def command(self, line: str, now_s: float) -> str:
        """The answer to a line of its command port."""
        ...

    def advance(self, to_s: float) -> bytes:
        """Stream samples of (last advance, to_s]."""
        ...

    def next_event_s(self) -> float | None:
        """When it will next do something by itself."""
        ...

    def inject(self, fault: str, now_s: float) -> None:
        """Switch a fault on, or all off. Raises BenchModelError for one that it cannot have."""
        ...
