"""A GNC module on its RS-422 link, as one branch of a sequence sees it.

Every command is bounded: an answer that does not come within its time is asked for again, at most
MAX_TRIES times (all commands can be repeated without harm), then the link raises. Whose fault that
is follows from what came. Damaged bytes (a wrong CRC, bytes outside frames): damage in transit, the
fixture is named, and the retest on another socket tells whether it was. Nothing, or nothing but
intact frames: the unit does not answer, and the runner looks at the fixture's own signs (presence
contact, supply) before the unit is blamed.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protocol.errors import Fault, LinkError, LinkTimeoutError
from protocol.gnc_module import (
    COEFFICIENTS_LAYOUT,
    IDENTITY_LAYOUT,
    SAMPLE_DTYPE,
    SELF_TEST_LAYOUT,
    SELF_TEST_REPLY_HEAD,
    START_STREAM_LAYOUT,
    TEST_DURATION_S,
    FrameType,
    ReplyStatus,
    SelfTest,
    Sensor,
)
from stations.drivers.clock import BranchClock, bytes_seen
from stations.drivers.frame_exchange import FrameExchange, LinkHealth

REPLY_TIMEOUT_S = 0.1
"""Bench time in which the unit answers a command (a self-test: says ACCEPTED)."""
DONE_MARGIN_S = 0.2
"""Bench time beyond a self-test's fixed duration in which its values must be there."""
BUSY_PAUSE_S = 0.05
BOOT_POLL_S = 0.02
"""How often a booting unit is asked."""
MAX_TRIES = 3
MAX_BUSY = 100

_DONE = frozenset({ReplyStatus.DONE})
_FLAG_COMPENSATED = 1


class UnitRefused(LinkError):
    """The unit answered, and the answer is no."""


@dataclass(frozen=True)
class UnitDescription:
    """What a unit says of itself."""

    serial: str
    firmware_version: str
    hardware_revision: str


class GncModuleLink:
    """Commands to the unit, on one branch's clock. The exchange under it is shared by all branches."""

    def __init__(self, exchange: FrameExchange, clock: BranchClock) -> None:
        self._exchange = exchange
        self._clock = clock

    @property
    def health(self) -> LinkHealth:
        """What the link did since the sequence began."""
        return self._exchange.health

    def identify(self) -> UnitDescription:
        """The unit's serial, firmware version and hardware revision.

        Raises:
            LinkError: no answer, or not one that can be read.
        """
        payload = self._command(FrameType.IDENTIFY)
        _, *texts = IDENTITY_LAYOUT.unpack(self._sized(b"\0" + payload, IDENTITY_LAYOUT, "IDENTIFY"))
        try:
            return UnitDescription(*(text.rstrip(b"\0").decode("ascii") for text in texts))
        except UnicodeDecodeError:
            raise self._wrong_answer("IDENTIFY", "its text is not ASCII") from None

    def self_test(
        self, test: SelfTest, argument: int = 0, *, while_running: Callable[[], None] | None = None
    ) -> bytes:
        """Run a self-test and return the bytes of its values.

        Args:
            test: which.
            argument: its argument.
            while_running: called once the unit has accepted, while it runs; again when it is repeated.

        Raises:
            UnitRefused: the unit does not know the test or its argument.
            LinkError: no answer after MAX_TRIES.
        """
        command = SELF_TEST_LAYOUT.pack(test, argument)
        sequences: list[int] = []
        tries = busy = 0
        try:
            while tries < MAX_TRIES and busy < MAX_BUSY:
                sequences.append(self._exchange.post(FrameType.SELF_TEST, command))
                tries += 1
                first = self._await(FrameType.SELF_TEST, sequences, REPLY_TIMEOUT_S, _ANY_STATUS)
                if first is None:
                    continue
                if first[0] is ReplyStatus.BUSY and tries == 1:
                    # another branch has the resource; after a lost ACCEPTED it would be our own test
                    busy, tries = busy + 1, 0
                    self._exchange.close_mailboxes(FrameType.SELF_TEST, sequences)
                    sequences.clear()
                    self._clock.sleep_until(self._clock.now_s() + BUSY_PAUSE_S)
                    continue
                if first[0] in (ReplyStatus.UNKNOWN, ReplyStatus.INVALID):
                    raise self._refused(f"self-test {test.name}, argument {argument}", first[0])
                if while_running is not None:
                    while_running()
                timeout_s = TEST_DURATION_S[test] + DONE_MARGIN_S
                done = self._await(FrameType.SELF_TEST, sequences, timeout_s, _DONE)
                if done is not None:
                    return self._values(test, argument, done[1])
            raise self.no_answer(f"self-test {test.name}, asked {MAX_TRIES} times")
        finally:
            self._exchange.close_mailboxes(FrameType.SELF_TEST, sequences)

    def start_stream(self, rate_hz: int, compensated: bool) -> None:
        """Let the unit send samples; they are collected until `stop_stream`.

        Raises:
            UnitRefused: the rate is not one of the unit's.
            LinkError: no answer.
        """
        self._exchange.begin_samples()
        flags = _FLAG_COMPENSATED if compensated else 0
        self._command(FrameType.START_STREAM, START_STREAM_LAYOUT.pack(rate_hz, flags))

    def stop_stream(self) -> NDArray[np.void]:
        """Stop the stream; all its samples, shape (n,), SAMPLE_DTYPE.

        Samples that were lost show as jumps of `counter`; what was damaged is in `health`.

        Raises:
            LinkError: no answer.
        """
        self._command(FrameType.STOP_STREAM)
        return self._exchange.take_samples()

    def collect(self) -> None:
        """Take in what the stream has brought so far. Raises LinkError: the port is gone."""
        self._exchange.collect()

    def write_coefficients(self, sensor: Sensor, K: ArrayLike, bias: ArrayLike) -> None:
        """Write u = K (y − b) into the unit's flash.

        Args:
            sensor: which triad.
            K: (3, 3), dimensionless.
            bias: (3,), rad/s or m/s².

        Raises:
            UnitRefused: the flash cannot be written.
            LinkError: no answer.
        """
        matrix = np.asarray(K, dtype=np.float64).reshape(9)
        vector = np.asarray(bias, dtype=np.float64).reshape(3)
        self._command(
            FrameType.WRITE_COEFFICIENTS,
            COEFFICIENTS_LAYOUT.pack(sensor, *matrix.tolist(), *vector.tolist()),
        )

    def read_coefficients(self, sensor: Sensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The matrix (3, 3) and the bias (3,) in the unit.

        Raises:
            LinkError: no answer, or not one that can be read.
        """
        payload = self._command(FrameType.READ_COEFFICIENTS, bytes([sensor]))
        _, *numbers = COEFFICIENTS_LAYOUT.unpack(
            self._sized(payload, COEFFICIENTS_LAYOUT, "READ_COEFFICIENTS")
        )
        return np.array(numbers[:9]).reshape(3, 3), np.array(numbers[9:])

    def echo(self, payload: bytes) -> bytes:
        """What the unit sends back for these bytes.

        Raises:
            LinkError: no answer.
        """
        return self._command(FrameType.ECHO, payload)

    def reset(self) -> None:
        """Restart the unit's firmware. Raises LinkError: no answer."""
        self._command(FrameType.RESET)

    def answers_within(self, until_s: float) -> bool:
        """Ask for the identity until the unit answers (True) or until a moment of bench time (False)."""
        sequences: list[int] = []
        try:
            while self._clock.now_s() < until_s:
                sequences.append(self._exchange.post(FrameType.IDENTIFY, b""))
                left_s = until_s - self._clock.now_s()
                if self._await(FrameType.IDENTIFY, sequences, min(BOOT_POLL_S, left_s), _DONE):
                    return True
            return False
        finally:
            self._exchange.close_mailboxes(FrameType.IDENTIFY, sequences)

    def _command(self, frame_type: FrameType, payload: bytes = b"") -> bytes:
        """A command that is answered once: the payload after the status byte."""
        sequences: list[int] = []
        try:
            for _ in range(MAX_TRIES):
                sequences.append(self._exchange.post(frame_type, payload))
                answer = self._await(frame_type, sequences, REPLY_TIMEOUT_S, _ANY_STATUS)
                if answer is None:
                    continue
                repeated = len(sequences) > 1
                if repeated and frame_type is FrameType.START_STREAM and answer[0] is ReplyStatus.BUSY:
                    return answer[1]  # the first reply was lost: the stream that it announced is running
                if answer[0] is not ReplyStatus.DONE:
                    raise self._refused(frame_type.name, answer[0])
                return answer[1]
            raise self.no_answer(f"{frame_type.name}, asked {MAX_TRIES} times")
        finally:
            self._exchange.close_mailboxes(frame_type, sequences)

    def _await(
        self,
        frame_type: FrameType,
        sequences: Sequence[int],
        timeout_s: float,
        wanted: frozenset[ReplyStatus],
    ) -> tuple[ReplyStatus, bytes] | None:
        """The first wanted reply to any of these commands; None if none comes in time."""
        until_s = self._clock.now_s() + timeout_s
        waiting = True
        while True:
            seen = bytes_seen(self._exchange.port)
            self._exchange.collect(line_is_silent=not waiting)
            for sequence in sequences:
                replies = self._exchange.replies(frame_type, sequence)
                for status in wanted:
                    if status in replies:
                        return status, replies[status]
            if not waiting:
                return None
            waiting = self._clock.wait_for_bytes(self._exchange.port, seen, until_s)

    def _values(self, test: SelfTest, argument: int, payload: bytes) -> bytes:
        head = SELF_TEST_REPLY_HEAD.size - 1
        if len(payload) < head or SELF_TEST_LAYOUT.unpack(payload[:head]) != (test, argument):
            raise self._wrong_answer(f"self-test {test.name}", f"it is headed {payload[:head].hex(' ')}")
        return payload[head:]

    def _sized(self, payload: bytes, layout: struct.Struct, what: str) -> bytes:
        if len(payload) != layout.size:
            raise self._wrong_answer(what, f"it has {len(payload)} bytes, not {layout.size}")
        return payload

    def _wrong_answer(self, what: str, why: str) -> LinkError:
        return LinkError(
            f"The unit's answer to {what} cannot be read: {why}.",
            where=self._exchange.where,
            fault=Fault.UNIT,
            remedy="check the unit's firmware version.",
        )

    def _refused(self, what: str, status: ReplyStatus) -> UnitRefused:
        return UnitRefused(
            f"The unit answered {status.name} to {what}.",
            where=self._exchange.where,
            fault=Fault.UNIT,
            remedy="check the unit's firmware version and its flash.",
        )

    def no_answer(self, what: str) -> LinkError:
        """The error for a silent unit: its own fault, or damage in transit, by what else came."""
        health = self.health
        story = (
            f"{health.bytes_received} bytes received, {health.frames.frames} frames, "
            f"{health.frames.crc_errors} with a wrong CRC, {health.frames.dropped_bytes} bytes dropped",
        )
        damaged = health.frames.crc_errors > 0 or health.frames.dropped_bytes > 0
        if damaged:
            return LinkError(
                f"No intact answer to {what}, but damaged bytes ({story[0]}).",
                where=self._exchange.where,
                fault=Fault.FIXTURE,
                remedy="check the socket's RS-422 contacts and cable; a retest on another socket tells.",
                story=story,
            )
        return LinkTimeoutError(
            f"No answer to {what} ({story[0]}).",
            where=self._exchange.where,
            fault=Fault.UNIT,
            remedy="look at the unit's current and boot; a retest on another socket tells.",
            story=story,
        )


_ANY_STATUS = frozenset(ReplyStatus)

__all__ = ["SAMPLE_DTYPE", "GncModuleLink", "UnitDescription", "UnitRefused"]
