"""A capture over ports that keep little, as a computer's own do: nobody else reads them during a rest."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from protocol.frames import Frame, FrameParser, encode_equal_frames, encode_frame
from protocol.gnc_module import REPLY_BIT, SAMPLE_DTYPE, FrameType
from protocol.stand_stream import STAND_SAMPLE_DTYPE
from stations.drivers.clock import WALL_POLL_S, BranchClock
from stations.drivers.frame_exchange import FrameExchange
from stations.drivers.turntable import LineTurntable
from stations.drivers.unit_link import GncModuleLink
from stations.imu_stand.capture import TurnProfile, capture_poses, capture_turns

TTY_BUFFER_BYTES = 4096
"""What Linux keeps of a terminal's input (N_TTY); what comes on top is lost."""
RATE_HZ = 200


class TtyPort:
    """A port that keeps `TTY_BUFFER_BYTES` and counts what it had to drop."""

    def __init__(self, on_write: Callable[[bytes], None] = lambda data: None) -> None:
        self._kept = b""
        self._on_write = on_write
        self.dropped = 0

    @property
    def in_waiting(self) -> int:
        return len(self._kept)

    def read(self, size: int) -> bytes:
        taken, self._kept = self._kept[:size], self._kept[size:]
        return taken

    def write(self, data: bytes) -> None:
        self._on_write(data)

    def arrive(self, data: bytes) -> None:
        room = TTY_BUFFER_BYTES - len(self._kept)
        self._kept += data[:room]
        self.dropped += max(0, len(data) - room)


class SimulatedHardware(BranchClock):
    """A unit and a stand that stream at `RATE_HZ`; time passes as the wall clock does, in polls."""

    def __init__(self) -> None:
        super().__init__()
        self._ticks = 0  # of 1 / RATE_HZ
        self._unit_streams = self._stand_streams = False
        self._counter = 0
        self._parser = FrameParser()
        self._outer_deg = (0.0, 0.0, 0.0, 0.0)  # from, to, when, for how long
        self._others_deg = (0.0, 0.0)
        self.unit_port = TtyPort(self._commanded)
        self.stand_port = TtyPort()

    # the clock

    def now_s(self) -> float:
        return self._ticks / RATE_HZ

    def _wait(self, until_s: float, port: Any | None, seen: int) -> None:
        end_s = min(until_s, self.now_s() + WALL_POLL_S)
        for _ in range(max(1, round((end_s - self.now_s()) * RATE_HZ))):
            self._ticks += 1
            self._sample()

    def _synchronise(self) -> None: ...

    def catch_up(self) -> None: ...

    def join(self) -> None: ...

    def leave(self) -> None: ...

    # the unit

    def _commanded(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            assert isinstance(frame, Frame)
            if frame.type in (FrameType.START_STREAM, FrameType.STOP_STREAM):
                self._unit_streams, self._counter = frame.type == FrameType.START_STREAM, 0
            self.unit_port.arrive(encode_frame(frame.type | REPLY_BIT, frame.sequence, b"\0"))

    def _sample(self) -> None:
        if self._unit_streams:
            row = np.zeros(1, SAMPLE_DTYPE)
            row["counter"] = self._counter
            payload = row.view(np.uint8).reshape(1, -1)
            self.unit_port.arrive(encode_equal_frames(FrameType.STREAM_SAMPLE, self._counter % 256, payload))
            self._counter += 1
        if self._stand_streams:
            row = np.zeros(1, STAND_SAMPLE_DTYPE)
            row["time_s"] = self.now_s()
            row["angles_rad"] = np.radians([self._outer_now_deg(), *self._others_deg])
            row["rate_rad_s"] = 10.0
            self.stand_port.arrive(row.tobytes())

    def _outer_now_deg(self) -> float:
        start, end, began_s, for_s = self._outer_deg
        share = min(1.0, (self.now_s() - began_s) / for_s) if for_s else 1.0
        return start + (end - start) * share

    # the stand's controller

    def ask(self, command: str) -> str:
        word, _, rest = command.partition(" ")
        if word == "MOVE":
            outer, *others = map(float, rest.split(","))
            self._outer_deg, self._others_deg = (outer, outer, 0.0, 0.0), (others[0], others[1])
            return "0.1"
        if word == "ROT":
            _, angle, duration, _ = rest.split(",")
            now_deg = self._outer_now_deg()
            self._outer_deg = (now_deg, now_deg + float(angle), self.now_s(), float(duration))
            return duration
        if word == "STRE":
            self._stand_streams = rest.startswith("ON")
            return ""
        return ",".join(["READY", *map(str, (self._outer_now_deg(), *self._others_deg, 0, 0, 0, 23))])

    where = "simulated stand"


@pytest.fixture
def hardware() -> SimulatedHardware:
    return SimulatedHardware()


@pytest.fixture
def context(hardware: SimulatedHardware) -> Any:
    exchange = FrameExchange(hardware.unit_port, "simulated unit")
    return SimpleNamespace(
        clock=hardware,
        unit=GncModuleLink(exchange, hardware),
        stand=LineTurntable(hardware, hardware.stand_port, hardware),  # type: ignore[arg-type]
    )


def test_a_rest_of_half_a_minute_is_recorded_whole(context: Any, hardware: SimulatedHardware) -> None:
    captures = capture_poses(context, duration_s=30.0, rate_hz=RATE_HZ, compensated=False)
    assert [len(capture.dut) for capture in captures] == [6000] * 6
    assert [len(capture.stand) for capture in captures] == [6000] * 6
    assert (hardware.unit_port.dropped, hardware.stand_port.dropped) == (0, 0)


def test_a_turn_is_recorded_whole(context: Any, hardware: SimulatedHardware) -> None:
    turn = TurnProfile(angle_deg=1080.0, duration_s=5.0, ramp_s=2.2, rest_s=10.0)
    captures = capture_turns(context, turn, rate_hz=RATE_HZ, compensated=False)
    assert min(len(capture.dut) for capture in captures) >= 15.5 * RATE_HZ
    assert (hardware.unit_port.dropped, hardware.stand_port.dropped) == (0, 0)


def test_outside_a_capture_nobody_reads_the_ports(context: Any, hardware: SimulatedHardware) -> None:
    capture_poses(context, duration_s=1.0, rate_hz=RATE_HZ, compensated=False)
    hardware.unit_port.arrive(b"noise")
    hardware.sleep_for(1.0)
    assert hardware.unit_port.in_waiting == 5
