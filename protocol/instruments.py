"""What stations ask of clocks, links, instruments and stands; a driver is one class that offers it.

The virtual and the real driver pass the same conformance tests. All times are the bench's, in s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class BenchClock(Protocol):
    """The bench's time. On hardware it is the wall clock; in the emulator it waits in lock-step."""

    def now_s(self) -> float:
        """Bench time."""
        ...

    def sleep_until(self, time_s: float) -> None:
        """Let bench time pass. Raises SequenceAborted's cause when the sequence is aborted meanwhile."""
        ...


class PowerSupply(Protocol):
    """A supply with a channel for each socket."""

    def configure(self, channel: int, voltage_v: float, current_limit_a: float) -> None: ...

    def switch(self, channel: int, on: bool) -> None: ...

    def measure_voltage_v(self, channel: int) -> float: ...

    def measure_current_a(self, channel: int) -> float: ...


class Multimeter(Protocol):
    """A multimeter whose inputs the socket board routes to two test points."""

    def measure_resistance_ohm(self) -> float: ...

    def measure_voltage_v(self) -> float: ...


class Oscilloscope(Protocol):
    """An oscilloscope whose input the socket board routes to a test point."""

    def measure_period_s(self) -> float: ...

    def measure_peak_to_peak_v(self) -> float: ...


class SocketBoard(Protocol):
    """The board under a socket: routing of test points, AD switch, presence contact."""

    def route(self, high: str, low: str) -> None: ...

    def open_all(self) -> None: ...

    def set_ad_switch(self, source: str) -> None: ...

    def unit_present(self) -> bool: ...


EMULATED_MAKER = "Testloom"
"""First word of an emulated stand's `*IDN?`: no maker of hardware is called so."""


@dataclass(frozen=True)
class StandFacts:
    """Which stand, as its controller says.

    Attributes:
        identification: answer to `*IDN?`: maker, model, serial number, version.
        calibration_due: ISO date until which its own calibration holds.
        stand_id, kind: as the bench's description has them.
        emulated: no hardware is behind it.
    """

    stand_id: str
    kind: str
    identification: str
    calibration_due: str
    emulated: bool


class ThreeAxisTurntable(Protocol):
    """Gimbal angles outer (about the vertical), middle, inner, in deg at the controller's own interface."""

    def facts(self) -> StandFacts:
        """Which stand it is and until when it is calibrated."""
        ...

    def home(self) -> None: ...

    def move_to(self, angles_deg: Sequence[float]) -> None:
        """Move at the stand's own positioning rate; returns when in position."""
        ...

    def rotate(self, axis: str, angle_deg: float, duration_s: float, ramp_s: float) -> None:
        """Turn an axis by an angle on a trapezoid of rate; returns when at rest."""
        ...

    def start_stream(self, rate_hz: float) -> None: ...

    def collect(self) -> None:
        """Take in what the stream has brought so far: a port keeps little."""
        ...

    def stop_stream(self) -> NDArray[np.void]:
        """The encoder samples since `start_stream`."""
        ...

    def stop(self) -> None: ...
