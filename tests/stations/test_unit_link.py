"""The unit's link against a scripted unit: replies lost, doubled, late, damaged, side by side."""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.errors import Fault, LinkError, LinkTimeoutError
from protocol.frames import Frame, FrameParser, encode_frame
from protocol.gnc_module import (
    IDENTITY_LAYOUT,
    SAMPLE_DTYPE,
    TEST_DURATION_S,
    FrameType,
    ReplyStatus,
    SelfTest,
    Sensor,
)
from stations.drivers.clock import BranchClock
from stations.drivers.frame_exchange import FrameExchange
from stations.drivers.unit_link import MAX_TRIES, GncModuleLink, UnitRefused
from stations.interruptions import AbortFlag, SequenceAborted, StepTimeout

Answer = Callable[[Frame], list[tuple[float, bytes]]]


def reply(frame: Frame, status: ReplyStatus, payload: bytes = b"") -> bytes:
    return encode_frame(frame.type | 0x80, frame.sequence, bytes([status]) + payload)


class ScriptedPort:
    """A port whose far end answers by a script: for each command, (delay, bytes) pairs."""

    def __init__(self, answer: Answer) -> None:
        self.now_s = 0.0
        self.commands: list[Frame] = []
        self.due: list[tuple[float, bytes]] = []
        self._answer = answer
        self._parser = FrameParser()
        self._ready = b""

    def write(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            assert isinstance(frame, Frame)
            self.commands.append(frame)
            self.due += [(self.now_s + delay, answer) for delay, answer in self._answer(frame)]

    def pass_to(self, time_s: float) -> None:
        """Time moves to the next answer, at most to `time_s`."""
        self.due.sort(key=lambda pair: pair[0])
        self.now_s = min([time_s, *(at for at, _ in self.due if at > self.now_s)])
        while self.due and self.due[0][0] <= self.now_s:
            self._ready += self.due.pop(0)[1]

    @property
    def in_waiting(self) -> int:
        return len(self._ready)

    def read(self, size: int) -> bytes:
        data, self._ready = self._ready[:size], self._ready[size:]
        return data


class ScriptedClock(BranchClock):
    """Time that moves only when a wait moves it."""

    def __init__(self, port: ScriptedPort) -> None:
        super().__init__()
        self._port = port

    def now_s(self) -> float:
        return self._port.now_s

    def _wait(self, until_s, port, seen) -> None:
        self._port.pass_to(until_s)

    def _synchronise(self) -> None: ...

    def catch_up(self) -> None: ...

    def join(self) -> None: ...

    def leave(self) -> None: ...


def link_to(answer: Answer) -> tuple[GncModuleLink, ScriptedPort, ScriptedClock]:
    port = ScriptedPort(answer)
    clock = ScriptedClock(port)
    return GncModuleLink(FrameExchange(port, "test"), clock), port, clock


def test_an_identity_is_read():
    identity = IDENTITY_LAYOUT.pack(0, b"GNC-1", b"1.4.2", b"C")[1:]
    link, _, _ = link_to(lambda frame: [(0.001, reply(frame, ReplyStatus.DONE, identity))])
    said = link.identify()
    assert (said.serial, said.firmware_version, said.hardware_revision) == ("GNC-1", "1.4.2", "C")


def self_test_unit(frame: Frame, values: bytes = b"\x07\0\0\0") -> list[tuple[float, bytes]]:
    done = reply(frame, ReplyStatus.DONE, frame.payload + values)
    return [(0.001, reply(frame, ReplyStatus.ACCEPTED)), (TEST_DURATION_S[SelfTest.CAN], done)]


def test_a_self_test_returns_its_values_and_doubled_replies_are_ignored():
    def doubled(frame: Frame) -> list[tuple[float, bytes]]:
        return [(at, data + data) for at, data in self_test_unit(frame)]

    link, port, _ = link_to(doubled)
    assert link.self_test(SelfTest.CAN) == b"\x07\0\0\0"
    assert len(port.commands) == 1
    assert link.health.unexpected_replies >= 1
    # what is doubled late must not answer the next command
    assert link.self_test(SelfTest.CAN) == b"\x07\0\0\0"


def test_a_lost_acceptance_is_survived_by_the_running_tests_own_result():
    seen: list[int] = []

    def unit(frame: Frame) -> list[tuple[float, bytes]]:
        seen.append(frame.sequence)
        if len(seen) == 1:
            return self_test_unit(frame)[1:]  # the acceptance is lost
        return [(0.001, reply(frame, ReplyStatus.BUSY))]  # it is our own first test that runs

    link, port, _ = link_to(unit)
    assert link.self_test(SelfTest.CAN) == b"\x07\0\0\0"
    assert len(port.commands) == 2


def test_a_silent_unit_is_asked_a_bounded_number_of_times():
    link, port, _ = link_to(lambda frame: [])
    with pytest.raises(LinkTimeoutError) as silent:
        link.identify()
    assert len(port.commands) == MAX_TRIES
    assert silent.value.fault is Fault.UNIT


def test_damage_in_transit_is_the_fixtures():
    def damaged(frame: Frame) -> list[tuple[float, bytes]]:
        answer = reply(frame, ReplyStatus.DONE, b"x" * 64)
        return [(0.001, answer[:-1] + bytes([answer[-1] ^ 0xFF]))]

    link, port, _ = link_to(damaged)
    with pytest.raises(LinkError) as broken:
        link.echo(b"x" * 64)
    assert broken.value.fault is Fault.FIXTURE
    assert len(port.commands) == MAX_TRIES
    assert link.health.frames.crc_errors == MAX_TRIES


def test_a_reply_held_back_by_a_damaged_length_is_found_when_the_line_falls_silent():
    def behind_false_header(frame: Frame) -> list[tuple[float, bytes]]:
        false_header = b"\xeb\x90\x88\x00" + (1000).to_bytes(2, "little")
        return [(0.001, false_header + reply(frame, ReplyStatus.DONE, frame.payload))]

    link, port, _ = link_to(behind_false_header)
    assert link.echo(b"hello") == b"hello"
    assert len(port.commands) == 1


@pytest.mark.parametrize("status", [ReplyStatus.INVALID, ReplyStatus.UNKNOWN, ReplyStatus.FLASH_ERROR])
def test_a_no_is_said_by_its_name(status: ReplyStatus):
    link, _, _ = link_to(lambda frame: [(0.001, reply(frame, status))])
    with pytest.raises(UnitRefused, match=status.name):
        link.write_coefficients(Sensor.GYRO, np.eye(3), np.zeros(3))


def test_a_busy_resource_is_waited_for():
    answers = iter([ReplyStatus.BUSY, ReplyStatus.BUSY])

    def unit(frame: Frame) -> list[tuple[float, bytes]]:
        status = next(answers, None)
        return self_test_unit(frame) if status is None else [(0.001, reply(frame, status))]

    link, port, _ = link_to(unit)
    assert link.self_test(SelfTest.CAN) == b"\x07\0\0\0"
    assert len(port.commands) == 3


def test_branches_find_their_own_replies():
    """Two views of one exchange: whoever reads sorts for both, in whatever order replies come."""
    port = ScriptedPort(self_test_unit)
    exchange = FrameExchange(port, "test")
    one, other = (exchange.post(FrameType.ECHO, name) for name in (b"one", b"other"))
    port.due = [
        (0.1, encode_frame(FrameType.ECHO | 0x80, other, b"\0other")),
        (0.2, encode_frame(FrameType.ECHO | 0x80, one, b"\0one")),
    ]
    port.pass_to(0.1)
    port.pass_to(0.2)
    exchange.collect()
    assert exchange.replies(FrameType.ECHO, one) == {0: b"one"}
    assert exchange.replies(FrameType.ECHO, other) == {0: b"other"}


def test_a_stream_comes_whole_and_in_order():
    samples = np.zeros(100, SAMPLE_DTYPE)
    samples["counter"] = np.arange(100)
    samples["gyro"] = np.arange(300).reshape(100, 3)
    frames = [encode_frame(FrameType.STREAM_SAMPLE, i % 256, row.tobytes()) for i, row in enumerate(samples)]

    def unit(frame: Frame) -> list[tuple[float, bytes]]:
        done = reply(frame, ReplyStatus.DONE)
        if frame.type == FrameType.STOP_STREAM:
            return [(0.001, b"".join(frames[5:])), (0.002, done)]
        return [(0.001, done), (0.002, b"".join(frames[:5]))]

    link, _, clock = link_to(unit)
    link.start_stream(200, compensated=False)
    clock.sleep_until(1.0)
    received = link.stop_stream()
    np.testing.assert_array_equal(received, samples)


def test_coefficients_go_and_come_row_by_row():
    K, bias = np.arange(9.0).reshape(3, 3), np.array([0.1, 0.2, 0.3])
    store: list[bytes] = []

    def unit(frame: Frame) -> list[tuple[float, bytes]]:
        if frame.type == FrameType.WRITE_COEFFICIENTS:
            store.append(frame.payload)
            return [(0.001, reply(frame, ReplyStatus.DONE))]
        return [(0.001, reply(frame, ReplyStatus.DONE, store[-1]))]

    link, _, _ = link_to(unit)
    link.write_coefficients(Sensor.ACC, K, bias)
    assert store[0][0] == Sensor.ACC
    np.testing.assert_array_equal(np.frombuffer(store[0][1:], "<f8"), [*range(9), 0.1, 0.2, 0.3])
    read_K, read_bias = link.read_coefficients(Sensor.ACC)
    np.testing.assert_array_equal(read_K, K)
    np.testing.assert_array_equal(read_bias, bias)


def test_waits_look_at_aborts_and_deadlines():
    link, _, clock = link_to(lambda frame: [])
    clock.limit(0.05)
    with pytest.raises(StepTimeout) as late:
        link.identify()
    assert not late.value.of_sequence
    clock.limit(None, clock.now_s() + 0.05)
    with pytest.raises(StepTimeout) as over:
        link.identify()
    assert over.value.of_sequence
    clock.limit(None)
    abort = AbortFlag()
    abort.request("enough")
    clock.interruption = abort.check
    with pytest.raises(SequenceAborted, match="enough"):
        link.identify()
