"""What a streaming unit says on CAN, and its receiver handed through on RS-422."""

import dataclasses
import io
import math
import struct
from typing import Any

import numpy as np
import pytest
from pyubx2 import ERR_RAISE, UBXReader

from dut_emulator.interfaces import LinkOutput, Surroundings
from dut_emulator.products.gnc_module import GncModule
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import UnitTruth
from dut_emulator.stands.catalogue import live_stand
from dut_emulator.stands.level_board import LevelBoard
from protocol import gnc_module as product
from protocol.bench_description import Site
from protocol.can_database import GNC_RATE, GNC_SPECIFIC_FORCE, decode_can, message_period_s
from protocol.frames import Frame, FrameParser, encode_frame
from protocol.gnc_module import SAMPLE_DTYPE, FrameType, ReplyStatus, SelfTest

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
UNIT = draw_unit(7, "GM-0002")
GYRO_LSB, ACC_LSB = math.radians(product.GYRO_LSB_DEG_S), product.ACC_LSB_G * 9.80665


def powered(truth: UnitTruth = UNIT, surroundings: Surroundings | None = None) -> GncModule:
    unit = GncModule(truth)
    unit.insert(surroundings or LevelBoard(SITE), 0.0)
    unit.set_supply(5.0, 0.0)
    unit.advance(2.0)
    return unit


def frames(outputs: list[LinkOutput]) -> list[Frame]:
    data = b"".join(output.data for output in outputs if output.link == "rs422")
    return [
        frame
        for item in FrameParser().feed(data)
        for frame in ((item,) if isinstance(item, Frame) else item.frames())
    ]


@pytest.mark.parametrize(("rate_hz", "every"), [(50, 1), (100, 1), (200, 2), (400, 4)])
def test_rate_and_force_on_can_are_the_streams_samples(rate_hz: int, every: int) -> None:
    """A compensated stream and CAN say the same of a sample, to half a bit; every 10 ms if there is one."""
    assert message_period_s(GNC_RATE) == message_period_s(GNC_SPECIFIC_FORCE) == 0.01
    unit = powered()
    start = product.START_STREAM_LAYOUT.pack(rate_hz, 1)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, start), 2.0)
    outputs = unit.advance(5.1)
    unit.receive("rs422", encode_frame(FrameType.STOP_STREAM, 2, b""), 5.13)
    outputs += unit.advance(6.0)
    assert [o.time_s for o in outputs] == sorted(o.time_s for o in outputs)
    payloads = [frame.payload for frame in frames(outputs) if frame.type == FrameType.STREAM_SAMPLE]
    rows = np.frombuffer(b"".join(payloads), SAMPLE_DTYPE)
    for name, kind, values, bit in (
        (GNC_RATE, "rate", rows["gyro"] * GYRO_LSB, 2**-12),
        (GNC_SPECIFIC_FORCE, "specific_force", rows["acc"] * ACC_LSB, 2**-6),
    ):
        sent = [frame for output in outputs if output.link == "can" for frame in output.frames()]
        said = [decode_can(frame.can_id, frame.data) for frame in sent if frame.can_id is not None]
        said = [message.signals for message in said if message.name == name]
        counters = [int(signals[f"{kind}_counter"]) for signals in said]
        assert counters == list(range(0, len(rows), every))
        seen = np.array([[signals[f"{kind}_{axis}"] for axis in "xyz"] for signals in said])
        assert np.abs(seen - values[::every]).max() <= bit / 2 + 1e-9
    after = [frame for output in unit.advance(7.0) for frame in output.frames()]
    assert after
    assert not any(frame.can_id in (0x110, 0x111) for frame in after)


def test_a_silent_bus_stays_silent_while_streaming() -> None:
    silent = dataclasses.replace(UNIT, digital=dataclasses.replace(UNIT.digital, can_silent=True))
    unit = powered(silent)
    start = product.START_STREAM_LAYOUT.pack(200, 0)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, start), 2.0)
    assert {o.link for o in unit.advance(4.0)} == {"rs422"}


def forward(unit: GncModule, rate_hz: int, protocols: int, now_s: float) -> None:
    payload = product.FORWARD_GNSS_LAYOUT.pack(rate_hz, protocols)
    unit.receive("rs422", encode_frame(FrameType.FORWARD_GNSS, 9, payload), now_s)


def said_by_the_receiver(outputs: list[LinkOutput]) -> list[Any]:
    """Messages of both protocols, as a client reads them."""
    data = b"".join(frame.payload for frame in frames(outputs) if frame.type == FrameType.GNSS_DATA)
    return [message for _, message in UBXReader(io.BytesIO(data), quitonerror=ERR_RAISE)]


def epochs(outputs: list[LinkOutput]) -> list[Any]:
    return [message for message in said_by_the_receiver(outputs) if message.identity == "NAV-PVT"]


def test_the_receiver_on_a_board_fixes_the_roofs_antenna() -> None:
    unit = powered()
    forward(unit, 5, 3, 60.03)
    outputs = unit.advance(70.0)
    fixes = epochs(outputs)
    times = [(fix.min * 60 + fix.second) + fix.nano * 1e-9 for fix in fixes]
    np.testing.assert_allclose(times, 60.2 + 0.2 * np.arange(50), atol=1e-6)
    sent = [o.time_s for o in outputs if o.link == "rs422" and len(o.data) > 100]
    np.testing.assert_allclose(sent, times, atol=1e-6)
    for fix in fixes:
        assert fix.fixType == 3
        assert fix.numSV == 12
        assert abs(fix.lat - 34.2) < 20 / 111_000
        assert abs(fix.height - 430_000) < 20_000  # mm
    said = said_by_the_receiver(outputs)
    assert [message.identity for message in said] == ["NAV-PVT", "GNGGA", "GNRMC"] * 50
    assert said[1].numSV == 12
    forward(unit, 0, 0, 70.1)
    assert not epochs(unit.advance(75.0))


@pytest.mark.parametrize("payload", [b"", b"\1", struct.pack("<BB", 2, 1), struct.pack("<BB", 5, 0), b"\5\4"])
def test_a_wrong_order_is_invalid(payload: bytes) -> None:
    unit = powered()
    unit.receive("rs422", encode_frame(FrameType.FORWARD_GNSS, 9, payload), 3.0)
    (answer,) = frames(unit.advance(4.0))
    assert (answer.type, answer.sequence) == (FrameType.FORWARD_GNSS | product.REPLY_BIT, 9)
    assert answer.payload == bytes((ReplyStatus.INVALID,))


def self_test(unit: GncModule, now_s: float) -> tuple[float, ...]:
    payload = product.SELF_TEST_LAYOUT.pack(SelfTest.GNSS, 0)
    unit.receive("rs422", encode_frame(FrameType.SELF_TEST, 3, payload), now_s)
    done = frames(unit.advance(now_s + 3.5))[-1].payload
    return product.GNSS_VALUES.unpack(done[product.SELF_TEST_REPLY_HEAD.size :])


def test_under_a_simulator_the_receiver_finds_what_is_played() -> None:
    stand = live_stand("satellite_simulator", 1, SITE, "GS-1")
    unit = powered(surroundings=stand.surroundings)
    assert self_test(unit, 2.0)[:2] == (0, 0)
    stand.port.command("SCEN satellite_trajectory,rest_s=60,speed_m_s=20,satellites=9", 10.0)
    stand.port.command("STAR", 10.0)
    forward(unit, 1, 1, 10.5)
    fixes = epochs(unit.advance(85.5))
    first = next(number for number, fix in enumerate(fixes) if fix.fixType == 3)
    assert 18 <= first <= 39  # seconds since the signals' start
    assert fixes[-1].numSV == 9
    assert fixes[-1].velN == pytest.approx(20_000, abs=200)  # at speed since 10 s before
    # the way by hand: 10 s at 2 m/s² and 4.94 s at 20 m/s, with a latency of some 60 ms
    north_m = math.radians(fixes[-1].lat - 34.2) * 6_356_000
    assert north_m == pytest.approx(100 + 20 * 4.94, abs=10)
    fix, used, _, _, _, _, speed, _ = self_test(unit, 86.0)
    assert (fix, used) == (3, 9)
    assert speed == pytest.approx(20.0, abs=0.3)
    stand.port.inject("no_signal", 90.0)
    assert self_test(unit, 92.0)[:2] == (0, 0)


def test_a_receiver_that_acquires_nothing_forwards_that() -> None:
    deaf = dataclasses.replace(UNIT, gnss=dataclasses.replace(UNIT.gnss, acquires=False))
    unit = powered(deaf)
    forward(unit, 1, 1, 100.0)
    fixes = epochs(unit.advance(103.5))
    assert [(fix.fixType, fix.numSV) for fix in fixes] == [(0, 0)] * 3
