"""The unit's interfaces (paper 1, section 3): IO in loop-back, SPI seen through IO, RS-422, CAN."""

import hashlib

from protocol.can_database import (
    GNC_STATUS,
    GNC_TEST_ECHO,
    GNC_TEST_REQUEST,
    PATTERN_MASK,
    EchoStatus,
)
from protocol.errors import Fault
from protocol.frames import SYNC
from protocol.gnc_module import CAN_VALUES, IO_VALUES, SelfTest
from stations.drivers.can_link import CanLink
from stations.interruptions import StepError
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step
from stations.steps.self_tests import self_test_watched, unpacked

IO_LINES = 4
ECHO_PAYLOAD_BYTES = 256
CAN_REQUESTS = 10
CAN_ANSWER_WITHIN_S = 0.05
"""The DBC says 10 ms; the rest is the adapter's and the operating system's."""
CAN_PATTERNS = (0x00000000, 0xFFFFFFFF, 0xAAAAAAAA, 0x55555555, 0x01234567, 0xFEDCBA98)
HEARTBEAT_WITHIN_S = 0.25
"""Two and a half of its periods."""


@step("test_io", ["io_patterns_sent", "io_patterns_wrong"])
def test_io(context: StepContext) -> None:
    """All four lines in a ring of loop-backs: each is an output once and an input once.

    The order of the ring follows from the attempt's id: another one at each attempt, the same one
    when an attempt is looked at again.
    """
    sent = wrong = 0
    bad: list[str] = []
    ring = io_ring(context.lease.attempt_id)
    for output_line, input_line in zip(ring, (*ring[1:], ring[0]), strict=True):
        values = context.unit.self_test(SelfTest.IO, output_line | input_line << 8)
        sent_here, wrong_here = unpacked(IO_VALUES, values, "self-test IO")
        sent, wrong = sent + int(sent_here), wrong + int(wrong_here)
        if wrong_here:
            bad.append(f"{output_line}→{input_line}")
    context.measure("io_patterns_sent", sent)
    context.measure("io_patterns_wrong", wrong)
    if bad:
        context.message = f"Wrong between lines: {', '.join(bad)}."


def io_ring(attempt_id: str) -> tuple[int, ...]:
    """The four lines in an order that depends on the attempt's id alone."""
    digest = hashlib.sha256(attempt_id.encode()).digest()
    return tuple(sorted(range(IO_LINES), key=lambda line: (digest[line], line)))


@step("test_spi", ["spi_bytes_sent", "spi_bytes_wrong"])
def test_spi(context: StepContext) -> None:
    """CS, CLK, SDIN and SDOUT as the four IO lines see them."""
    sent, wrong = unpacked(IO_VALUES, context.unit.self_test(SelfTest.SPI), "self-test SPI")
    context.measure("spi_bytes_sent", sent)
    context.measure("spi_bytes_wrong", wrong)


@step("test_rs422", ["rs422_bytes_sent", "rs422_bytes_wrong", "rs422_bytes_dropped"])
def test_rs422(context: StepContext) -> None:
    """Every byte value, alternating bits and sync patterns, there and back.

    `rs422_bytes_dropped` counts what came outside frames since the sequence began: noise on the line
    cannot be told from the fixture's, so a plan should record it without a limit.
    """
    every_byte = bytes(range(256))
    payloads = (every_byte, every_byte[::-1], b"\x55\xaa" * 128, (SYNC * 128)[:ECHO_PAYLOAD_BYTES])
    wrong = 0
    for payload in payloads:
        echoed = context.unit.echo(payload)
        wrong += abs(len(echoed) - len(payload))
        wrong += sum(one != other for one, other in zip(payload, echoed, strict=False))
    context.measure("rs422_bytes_sent", sum(map(len, payloads)))
    context.measure("rs422_bytes_wrong", wrong)
    context.measure("rs422_bytes_dropped", context.unit.health.frames.dropped_bytes)


@step("test_can", ["can_echoes_right", "can_frames_echoed", "can_heartbeat"])
def test_can(context: StepContext) -> None:
    """The heartbeat, and patterns that toggle every bit, echoed while the unit's CAN test is armed."""
    can = context.can
    if can is None:
        raise StepError(
            "This socket has no CAN interface.",
            where=f"socket {context.lease.socket}",
            fault=Fault.PLAN,
            remedy="run this plan on a socket-board bench, or leave the step out.",
        )
    can.discard()
    heartbeat = can.receive(context.clock.now_s() + HEARTBEAT_WITHIN_S, GNC_STATUS)
    context.measure("can_heartbeat", heartbeat is not None)
    right: list[bool] = []

    def exchange() -> None:
        right.clear()
        for counter in range(CAN_REQUESTS):
            right.append(_echo_is_right(context, can, counter))
            if not right[-1]:
                break  # the test is armed for a short time only; one miss is a FAIL already

    values = self_test_watched(context, SelfTest.CAN, 0, exchange)
    (echoed,) = unpacked(CAN_VALUES, values, "self-test CAN")
    context.measure("can_echoes_right", sum(right))
    context.measure("can_frames_echoed", echoed)


def _echo_is_right(context: StepContext, can: CanLink, counter: int) -> bool:
    pattern = CAN_PATTERNS[counter % len(CAN_PATTERNS)]
    can.discard()
    can.send(GNC_TEST_REQUEST, {"pattern": pattern, "counter": counter})
    answer = can.receive(context.clock.now_s() + CAN_ANSWER_WITHIN_S, GNC_TEST_ECHO)
    return answer is not None and answer.signals == {
        "inverted_pattern": pattern ^ PATTERN_MASK,
        "counter": counter,
        "status": EchoStatus.OK,
    }
