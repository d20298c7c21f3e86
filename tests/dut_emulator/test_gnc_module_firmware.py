"""The firmware on the wire: power, commands, every self-test, time by its own crystal, flash."""

import dataclasses
import json
import math
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from dut_emulator.interfaces import EmulatedUnit, LinkOutput
from dut_emulator.products.gnc_module import GncModule, make_unit
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.power import TRANSITIONS, PowerEvent, PowerState, next_state
from dut_emulator.products.gnc_module.unit_truth import Category, DigitalTruth, UnitTruth
from dut_emulator.stands.level_board import LevelBoard
from protocol import gnc_module as product
from protocol.bench_description import Site
from protocol.can_database import PATTERN_MASK, EchoStatus, UnitState, decode_can, encode_can
from protocol.errors import TestloomError
from protocol.frames import Frame, FrameParser, encode_frame
from protocol.gnc_module import FrameType, ReplyStatus, SelfTest

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
SEED = 7
POWER_ON_S = 0.25
READY_S = POWER_ON_S + 1.0


def healthy() -> UnitTruth:
    serials = (f"GM-{number:04d}" for number in range(1, 100))
    return next(unit for unit in (draw_unit(SEED, s) for s in serials) if unit.category is Category.HEALTHY)


HEALTHY = healthy()


class Wire:
    """A unit on a level board, and a host that talks to it frame by frame."""

    def __init__(self, truth: UnitTruth = HEALTHY, flash: dict[str, object] | None = None) -> None:
        self.unit = GncModule(truth, flash)
        self.unit.insert(LevelBoard(SITE), 0.0)
        self.can: list[LinkOutput] = []
        self.sequence = 0

    def powered(self) -> "Wire":
        """Booted."""
        self.unit.set_supply(5.0, POWER_ON_S)
        self.collect(READY_S)
        return self

    def send(self, type: int, payload: bytes, now_s: float) -> int:
        """One frame to the unit; its sequence."""
        self.sequence = (self.sequence + 1) % 256
        self.unit.receive("rs422", encode_frame(type, self.sequence, payload), now_s)
        return self.sequence

    def collect(self, to_s: float) -> list[tuple[float, Frame]]:
        """Frames that have come on RS-422; what came on CAN is kept aside."""
        frames: list[tuple[float, Frame]] = []
        parser = FrameParser()
        for output in self.unit.advance(to_s):
            if output.link == "can":
                self.can.append(output)
                continue
            for item in parser.feed(output.data):
                frames += [
                    (output.time_s, f) for f in ((item,) if isinstance(item, Frame) else item.frames())
                ]
        assert parser.pending_bytes == 0
        return frames

    def test(self, test: SelfTest, argument: int = 0, now_s: float = READY_S) -> tuple[float, bytes]:
        """Run a self-test: how long it took and the values of its DONE."""
        sequence = self.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(test, argument), now_s)
        (_, accepted), (done_s, done) = self.collect(now_s + 4.0)
        head = product.SELF_TEST_REPLY_HEAD
        assert accepted.type == done.type == FrameType.SELF_TEST | product.REPLY_BIT
        assert accepted.sequence == done.sequence == sequence
        assert head.unpack(accepted.payload) == (ReplyStatus.ACCEPTED, test, argument)
        assert head.unpack_from(done.payload) == (ReplyStatus.DONE, test, argument)
        return done_s - now_s, done.payload[head.size :]


def status_of(reply: tuple[float, Frame]) -> ReplyStatus:
    return ReplyStatus(reply[1].payload[0])


def with_digital(**changes: object) -> UnitTruth:
    return dataclasses.replace(HEALTHY, digital=dataclasses.replace(HEALTHY.digital, **changes))


@pytest.fixture
def wire() -> Wire:
    return Wire().powered()


# --- power


def test_every_transition_starts_where_another_ends() -> None:
    assert {state for state, _ in TRANSITIONS} == set(TRANSITIONS.values()) == set(PowerState)
    with pytest.raises(TestloomError):
        next_state(PowerState.OFF, PowerEvent.BOOTED)


def test_nothing_comes_from_an_unpowered_unit() -> None:
    wire = Wire()
    wire.send(FrameType.IDENTIFY, b"", 0.1)
    assert wire.unit.advance(10.0) == []
    assert wire.unit.next_event_s() is None
    assert wire.unit.supply_current_a(10.0) == 0.0


def test_boot_takes_its_time_and_hears_nothing() -> None:
    wire = Wire()
    wire.unit.set_supply(5.0, POWER_ON_S)
    wire.send(FrameType.IDENTIFY, b"", POWER_ON_S + 0.79)
    assert wire.collect(POWER_ON_S + 0.795) == []
    assert decode_can(256, wire.can[-1].data).signals["state"] == UnitState.STARTING
    wire.send(FrameType.IDENTIFY, b"", POWER_ON_S + 0.81)
    ((_, reply),) = wire.collect(POWER_ON_S + 0.82)
    _, serial, version, _ = product.IDENTITY_LAYOUT.unpack(reply.payload)
    assert serial.rstrip(b"\0").decode() == HEALTHY.serial
    assert version.rstrip(b"\0")


def test_current_goes_with_the_state(wire: Wire) -> None:
    assert wire.unit.supply_current_a(READY_S) == HEALTHY.measurands["supply_current"]
    wire.unit.set_supply(3.0, READY_S + 1)
    assert 0 < wire.unit.supply_current_a(READY_S + 1) < 1e-3
    wire.unit.set_supply(5.0, READY_S + 2)
    assert 0.2 < wire.unit.supply_current_a(READY_S + 2.1) < 0.4


def test_between_brown_out_and_turn_on_the_state_stays() -> None:
    wire = Wire()
    wire.unit.set_supply(4.2, 0.1)
    assert wire.unit.next_event_s() is None
    wire.unit.set_supply(4.4, 0.2)
    wire.unit.set_supply(4.2, 0.3)
    assert wire.unit.next_event_s() is not None


def test_brown_out_forgets_ram_and_keeps_flash(wire: Wire) -> None:
    layout = product.COEFFICIENTS_LAYOUT
    written = layout.pack(0, *np.eye(3).ravel() * 1.01, 0.001, 0.002, 0.003)
    wire.send(FrameType.WRITE_COEFFICIENTS, written, READY_S)
    assert [status_of(r) for r in wire.collect(READY_S + 0.1)] == [ReplyStatus.DONE]
    wire.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.GNSS, 0), READY_S + 0.2)
    wire.send(FrameType.START_STREAM, product.START_STREAM_LAYOUT.pack(200, 0), READY_S + 0.2)
    wire.collect(READY_S + 1.0)
    wire.unit.set_supply(0.0, READY_S + 1.0)
    wire.unit.set_supply(5.0, READY_S + 1.5)
    assert wire.collect(READY_S + 10.0) == []
    wire.send(FrameType.READ_COEFFICIENTS, b"\0", READY_S + 10.0)
    ((_, reply),) = wire.collect(READY_S + 10.1)
    assert reply.payload == bytes([ReplyStatus.DONE]) + written


def test_flash_goes_to_the_next_bench_as_json(wire: Wire) -> None:
    written = product.COEFFICIENTS_LAYOUT.pack(1, *np.eye(3).ravel() * 0.99, 0.1, 0.2, 0.3)
    wire.send(FrameType.WRITE_COEFFICIENTS, written, READY_S)
    image = json.loads(json.dumps(wire.unit.flash_image()))
    other = Wire(HEALTHY, image).powered()
    assert other.unit.flash_image()["power_cycles"] == image["power_cycles"] + 1
    other.send(FrameType.READ_COEFFICIENTS, b"\1", READY_S)
    assert other.collect(READY_S + 0.1)[0][1].payload[1:] == written
    with pytest.raises(TestloomError):
        GncModule(HEALTHY, {"format": "something else"})


def test_reset_boots_again_and_answers_first(wire: Wire) -> None:
    wire.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.GNSS, 0), READY_S)
    wire.send(FrameType.RESET, b"", READY_S + 0.1)
    replies = wire.collect(READY_S + 5.0)
    assert [status_of(r) for r in replies] == [ReplyStatus.ACCEPTED, ReplyStatus.DONE]
    assert replies[1][1].type == FrameType.RESET | product.REPLY_BIT
    states = [int(decode_can(256, o.data).signals["state"]) for o in wire.can if o.time_s > READY_S + 0.11]
    assert states[0] == UnitState.STARTING
    assert states[-1] == UnitState.IDLE


# --- commands


@pytest.mark.parametrize(
    ("type", "payload", "status"),
    [
        (0x55, b"", ReplyStatus.UNKNOWN),
        (FrameType.SELF_TEST, b"\1", ReplyStatus.INVALID),
        (FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(99, 0), ReplyStatus.UNKNOWN),
        (FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.TIMER, 700), ReplyStatus.INVALID),
        (FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.IO, 0x0101), ReplyStatus.INVALID),
        (FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.IO, 0x0400), ReplyStatus.INVALID),
        (FrameType.START_STREAM, product.START_STREAM_LAYOUT.pack(123, 0), ReplyStatus.INVALID),
        (FrameType.START_STREAM, b"", ReplyStatus.INVALID),
        (FrameType.WRITE_COEFFICIENTS, b"\0" * 97, ReplyStatus.INVALID),  # a singular matrix
        (
            FrameType.WRITE_COEFFICIENTS,
            product.COEFFICIENTS_LAYOUT.pack(0, *([math.nan] * 12)),
            ReplyStatus.INVALID,
        ),
        (FrameType.READ_COEFFICIENTS, b"\7", ReplyStatus.INVALID),
        (FrameType.STOP_STREAM, b"", ReplyStatus.DONE),
        (FrameType.ECHO, b"", ReplyStatus.DONE),
    ],
)
def test_bad_commands_are_refused_by_name(wire: Wire, type: int, payload: bytes, status: ReplyStatus) -> None:
    wire.send(type, payload, READY_S)
    ((time_s, reply),) = wire.collect(READY_S + 5.0)
    assert reply.type == type | product.REPLY_BIT
    assert reply.payload[0] == status
    assert READY_S < time_s < READY_S + 0.05


def test_echo_returns_any_payload(wire: Wire) -> None:
    payload = bytes(range(256))
    wire.send(FrameType.ECHO, payload, READY_S)
    ((_, reply),) = wire.collect(READY_S + 0.1)
    assert reply.payload == bytes([ReplyStatus.DONE]) + payload


def test_corrupt_frames_get_no_answer_and_raise_the_link_flag(wire: Wire) -> None:
    frame = bytearray(encode_frame(FrameType.ECHO, 1, b"hello"))
    frame[8] ^= 0x40
    wire.unit.receive("rs422", b"noise" + bytes(frame), READY_S)
    wire.unit.receive("rs422", encode_frame(FrameType.ECHO | 0x80, 1, b""), READY_S)  # somebody else's reply
    assert wire.collect(READY_S + 0.3) == []
    assert decode_can(256, wire.can[-1].data).signals["link_error"] == 1
    wire.send(FrameType.ECHO, b"still here", READY_S + 0.3)
    assert len(wire.collect(READY_S + 0.4)) == 1


def test_a_command_in_pieces_is_one_command(wire: Wire) -> None:
    frame = encode_frame(FrameType.ECHO, 9, b"abc")
    for number, byte in enumerate(frame):
        wire.unit.receive("rs422", bytes([byte]), READY_S + number * 1e-4)
    assert len(wire.collect(READY_S + 0.1)) == 1
    wire.unit.receive("rs422", frame[:6], READY_S + 0.2)  # cut off, then silence
    wire.send(FrameType.ECHO, b"", READY_S + 0.3)
    assert len(wire.collect(READY_S + 0.4)) == 1


# --- self-tests


@pytest.mark.parametrize("test", list(SelfTest))
def test_every_self_test_takes_its_time_by_the_units_crystal(test: SelfTest) -> None:
    slow = Wire(dataclasses.replace(HEALTHY, crystal_error=-0.01)).powered()
    argument = {SelfTest.TIMER: 1000, SelfTest.IO: 0x0100}.get(test, 0)
    duration_s, values = slow.test(test, argument)
    assert duration_s == pytest.approx(product.TEST_DURATION_S[test] / 0.99, rel=1e-9)
    assert values


def test_digital_self_tests_of_a_healthy_unit() -> None:
    assert struct.unpack("<II", Wire().powered().test(SelfTest.CPU)[1])[1] == 0
    for memory in (SelfTest.INTERNAL_RAM, SelfTest.SDRAM, SelfTest.SPI_FLASH, SelfTest.INTERNAL_FLASH):
        words, wrong, _ = struct.unpack("<III", Wire().powered().test(memory)[1])
        assert words > 50_000
        assert wrong == 0
    for test, argument in ((SelfTest.IO, 0x0100), (SelfTest.IO, 0x0203), (SelfTest.SPI, 0)):
        sent, wrong = struct.unpack("<II", Wire().powered().test(test, argument)[1])
        assert sent == 256
        assert wrong == 0


def test_a_bad_cell_is_read_where_it_is() -> None:
    truth = with_digital(wrong_addresses={SelfTest.SDRAM: (77, 78, 79)})
    assert struct.unpack("<III", Wire(truth).powered().test(SelfTest.SDRAM)[1])[1:] == (3, 77)
    assert struct.unpack("<III", Wire(truth).powered().test(SelfTest.INTERNAL_RAM)[1])[1] == 0
    wire = Wire(truth).powered()
    wire.test(SelfTest.SDRAM)
    assert decode_can(256, wire.can[-1].data).signals["memory_error"] == 1


def test_a_stuck_line_fails_every_pair_it_is_in() -> None:
    truth = with_digital(stuck_line=(2, 1))
    for argument, fails in ((0x0100, False), (0x0302, True), (0x0203, True), (0x0001, False)):
        assert (struct.unpack("<II", Wire(truth).powered().test(SelfTest.IO, argument)[1])[1] > 0) == fails
    assert struct.unpack("<II", Wire(truth).powered().test(SelfTest.SPI)[1])[1] > 0
    assert struct.unpack("<II", Wire(with_digital(spi_broken=True)).powered().test(SelfTest.SPI)[1])[1] > 0


@pytest.mark.parametrize("period_us", product.TIMER_PERIODS_US)
def test_timer_wave_has_the_crystals_period_while_the_test_runs(period_us: int) -> None:
    wire = Wire(dataclasses.replace(HEALTHY, crystal_error=-500e-6)).powered()
    assert wire.unit.point_period_s("TIMER_OUT", READY_S) is None
    wire.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.TIMER, period_us), READY_S)
    assert wire.unit.point_period_s("TIMER_OUT", READY_S + 0.09) == pytest.approx(period_us * 1e-6 / 0.9995)
    assert wire.unit.point_period_s("5V_1", READY_S + 0.09) is None
    assert wire.unit.point_period_s("TIMER_OUT", READY_S + 0.11) is None
    _, (_, done) = wire.collect(READY_S + 0.2)
    (interrupts,) = struct.unpack("<I", done.payload[6:])
    assert interrupts == 100_000 // period_us


def test_imu_at_rest_reads_what_the_truth_makes_of_gravity() -> None:
    _, payload = Wire().powered().test(SelfTest.IMU)
    values = np.array(struct.unpack("<13f", payload))
    scale = np.diag(1 + np.array(HEALTHY.acc.scale_factor_error))
    matrix = scale @ (np.eye(3) + np.array(HEALTHY.acc.misalignment_rad))
    expected = matrix @ [0.0, 0.0, 9.797] + np.array(HEALTHY.acc.bias_si)
    np.testing.assert_allclose(values[3:6], expected, atol=0.01)  # 1 mg
    np.testing.assert_allclose(values[:3], HEALTHY.gyro.bias_si, atol=math.radians(0.03))
    assert 23 < values[6] < 27
    ratio = values[7:13] / [HEALTHY.measurands[f"{s}_noise_{a}"] for s in ("gyro", "acc") for a in "xyz"]
    assert ((ratio > 0.8) & (ratio < 1.25)).all()


def test_gnss_fixes_the_antenna_within_its_error() -> None:
    _, payload = Wire().powered().test(SelfTest.GNSS)
    fix, satellites, _, latitude, longitude, height, speed, pulse = struct.unpack("<BBHddfff", payload)
    assert fix == 3
    assert satellites == HEALTHY.gnss.satellites_used
    # one arc minute of latitude at 34.2° is 1848.7 m, of longitude 1536.9 m (WGS 84 tables)
    north = (math.degrees(latitude) - 34.2) * 60 * 1848.7
    east = (math.degrees(longitude) - 108.9) * 60 * 1536.9
    np.testing.assert_allclose((east, north, height - 430.0), HEALTHY.gnss.position_error_m, atol=1.5)
    assert 0 <= speed < 0.15
    assert abs(pulse) < 80e-9
    lost = dataclasses.replace(
        HEALTHY, gnss=dataclasses.replace(HEALTHY.gnss, acquires=False, satellites_used=2)
    )
    assert Wire(lost).powered().test(SelfTest.GNSS)[1][:2] == bytes([0, 2])


def test_ad_reads_the_routed_source_and_the_magnetometer() -> None:
    for source, volts in (("5V", 5.0), ("3V3", 3.3), ("1V2", 1.2), ("GND", 0.0), ("OPEN", 0.0)):
        wire = Wire().powered()
        wire.unit.set_ad_source("GND", 0.7)  # routed before: one source at a time
        wire.unit.set_ad_source(source, volts)
        channels = np.array(struct.unpack("<8f", wire.test(SelfTest.AD)[1]))
        expected = np.zeros(5)
        expected[product.AD_CHANNEL_OF_SOURCE[source] - 4] = volts
        np.testing.assert_allclose(channels[3:] - HEALTHY.ad_error_v[3:], expected, atol=2e-3)
        # 27 µT north are 0.27 gauss: 67.5 mV; up −0.45 gauss
        np.testing.assert_allclose(channels[:3], [-0.00375, 0.0675, -0.1125], atol=0.045)
    wire = Wire(dataclasses.replace(HEALTHY, ad_off=4)).powered()
    wire.unit.set_ad_source("5V", 5.0)
    assert struct.unpack("<8f", wire.test(SelfTest.AD)[1])[3] == 0.0


def can_request(wire: Wire, pattern: int, counter: int, now_s: float) -> list[LinkOutput]:
    frame = encode_can("GNC_TEST_REQUEST", {"pattern": pattern, "counter": counter})
    wire.unit.receive("can", frame.data, now_s, frame.identifier)
    return [o for o in wire.unit.advance(now_s + 0.01) if o.link == "can" and o.can_id == 289]


def test_can_echo_is_inverted_and_only_ok_while_armed(wire: Wire) -> None:
    (early,) = can_request(wire, 0x12345678, 1, READY_S)
    assert decode_can(289, early.data).signals["status"] == EchoStatus.NOT_READY
    wire.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(SelfTest.CAN, 0), READY_S + 0.02)
    for counter, pattern in enumerate((0xAAAAAAAA, 0x55555555, 0)):
        (echo,) = can_request(wire, pattern, counter, READY_S + 0.03 + counter * 0.02)
        signals = decode_can(289, echo.data).signals
        assert int(signals["inverted_pattern"]) == pattern ^ PATTERN_MASK
        assert signals["counter"] == counter
        assert signals["status"] == EchoStatus.OK
    assert wire.collect(READY_S + 1.0)[-1][1].payload[-4:] == struct.pack("<I", 3)
    wire.unit.receive("can", b"\1\2", READY_S + 1.0, 0x7FF)  # a stranger's frame


def test_a_silent_can_says_nothing_at_all() -> None:
    wire = Wire(with_digital(can_silent=True)).powered()
    assert can_request(wire, 1, 1, READY_S) == []
    wire.collect(READY_S + 1.0)
    assert wire.can == []


def test_heartbeats_count_without_a_gap(wire: Wire) -> None:
    wire.collect(READY_S + 30.05)
    beats = [o for o in wire.can if o.can_id == 256]
    counters = [int(decode_can(256, o.data).signals["heartbeat_counter"]) for o in beats]
    assert counters == [number % 256 for number in range(len(beats))]
    assert len(beats) == 310  # 31.05 s since power-on
    signals = decode_can(256, beats[-1].data).signals
    assert signals["state"] == UnitState.IDLE
    assert signals["supply_voltage"] == pytest.approx(5.0)


def test_resources_run_side_by_side_and_one_test_each(wire: Wire) -> None:
    tests = (SelfTest.SDRAM, SelfTest.IMU, SelfTest.GNSS, SelfTest.CPU)
    for test in tests:
        wire.send(FrameType.SELF_TEST, product.SELF_TEST_LAYOUT.pack(test, 0), READY_S)
    replies = wire.collect(READY_S + 3.5)
    first = [status_of(r) for r in replies[:4]]
    assert first == [ReplyStatus.ACCEPTED] * 3 + [ReplyStatus.BUSY]
    ends = [time_s - READY_S for time_s, _ in replies[4:]]
    assert ends == pytest.approx([0.7, 1.0, 3.0], abs=1e-3)


def test_the_imu_is_busy_while_it_streams_or_is_tested(wire: Wire) -> None:
    start = product.START_STREAM_LAYOUT.pack(200, 0)
    imu = product.SELF_TEST_LAYOUT.pack(SelfTest.IMU, 0)
    wire.send(FrameType.SELF_TEST, imu, READY_S)
    wire.send(FrameType.START_STREAM, start, READY_S + 0.5)
    assert status_of(wire.collect(READY_S + 0.6)[-1]) is ReplyStatus.BUSY
    wire.collect(READY_S + 1.1)
    wire.send(FrameType.START_STREAM, start, READY_S + 1.1)
    wire.send(FrameType.SELF_TEST, imu, READY_S + 1.2)
    wire.send(FrameType.START_STREAM, start, READY_S + 1.2)
    statuses = [status_of(r) for r in wire.collect(READY_S + 1.25) if r[1].type & product.REPLY_BIT]
    assert statuses == [ReplyStatus.DONE, ReplyStatus.BUSY, ReplyStatus.BUSY]


# --- circuit


def test_resistances_are_the_truths_in_either_direction() -> None:
    unit = GncModule(HEALTHY)
    for prefix, pairs in (
        ("continuity", product.CONTINUITY_PAIRS),
        ("insulation", product.INSULATION_PAIRS),
        ("impedance", product.IMPEDANCE_PAIRS),
    ):
        for pair in pairs:
            expected = HEALTHY.measurands[f"{prefix}_{pair.name}"]
            assert (
                unit.resistance_ohm(pair.high, pair.low)
                == unit.resistance_ohm(pair.low, pair.high)
                == expected
            )
    assert unit.resistance_ohm("CAN_L", "CASE") == math.inf
    assert unit.resistance_ohm("CASE", "CASE") == 0.0


def with_resistance(name: str, ohm: float) -> UnitTruth:
    circuit = HEALTHY.electrical
    return dataclasses.replace(
        HEALTHY, electrical=dataclasses.replace(circuit, resistance_ohm={**circuit.resistance_ohm, name: ohm})
    )


def test_rails_stand_only_with_power(wire: Wire) -> None:
    assert wire.unit.point_voltage_v("3V3_1", READY_S) == HEALTHY.measurands["rail_3v3"]
    assert wire.unit.point_voltage_v("1V2_2", READY_S) == HEALTHY.measurands["rail_1v2"]
    drop = 5.0 - wire.unit.point_voltage_v("5V_1", READY_S)
    assert 0.005 < drop < 0.02
    assert wire.unit.point_voltage_v("GND_2", READY_S) == 0.0
    assert wire.unit.point_ripple_v("5V_1", READY_S) == HEALTHY.measurands["ripple_5v"]
    wire.unit.set_supply(0.0, READY_S)
    assert wire.unit.point_voltage_v("3V3_1", READY_S) == 0.0
    assert wire.unit.point_ripple_v("5V_1", READY_S) == 0.0


def test_a_shorted_rail_draws_its_current_and_gives_way() -> None:
    healthy_a = HEALTHY.measurands["supply_current"]
    wire = Wire(with_resistance("impedance_supply_5v", 2.0)).powered()
    assert wire.unit.supply_current_a(READY_S) == pytest.approx(healthy_a + 2.5)
    wire = Wire(with_resistance("impedance_rail_1v2", 0.2)).powered()
    assert wire.unit.point_voltage_v("1V2_1", READY_S) == pytest.approx(0.6)  # 3 A through 0.2 ohm
    assert wire.unit.supply_current_a(READY_S) == pytest.approx(healthy_a + 3.0 * 0.6 / 5.0 / 0.85)


# --- the interface's own rules


def test_time_does_not_go_back(wire: Wire) -> None:
    with pytest.raises(TestloomError):
        wire.unit.advance(READY_S - 0.5)


def test_power_needs_a_socket() -> None:
    with pytest.raises(TestloomError):
        GncModule(HEALTHY).set_supply(5.0, 0.0)


def steps(unit: EmulatedUnit, to_s: float) -> Iterator[LinkOutput]:
    """Everything until then, one event of the unit at a time."""
    while (event_s := unit.next_event_s()) is not None and event_s <= to_s:
        yield from unit.advance(event_s)
    yield from unit.advance(to_s)


def test_event_by_event_is_the_same_as_at_one_go() -> None:
    recorded = []
    for by_events in (False, True):
        unit = make_unit(SEED, HEALTHY.serial)
        unit.insert(LevelBoard(SITE), 0.0)
        unit.set_supply(5.0, POWER_ON_S)
        unit.advance(READY_S)
        unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, struct.pack("<HB", 200, 0)), READY_S)
        unit.receive("rs422", encode_frame(FrameType.SELF_TEST, 2, struct.pack("<BI", 8, 0)), READY_S)
        outputs = list(steps(unit, READY_S + 6.0) if by_events else unit.advance(READY_S + 6.0))
        assert [o.time_s for o in outputs] == sorted(o.time_s for o in outputs)
        can = [o for o in outputs if o.link == "can"]
        samples = b"".join(o.data for o in outputs if o.link == "rs422" and len(o.data) > 100)
        recorded.append((can, samples))
    assert recorded[0] == recorded[1]


def test_units_of_one_serial_say_the_same_and_hide_what_they_are() -> None:
    defective = next(
        unit for unit in (draw_unit(SEED, f"GM-{n:04d}") for n in range(1, 99)) if unit.category.is_defective
    )
    said = []
    for _ in range(2):
        wire = Wire(defective).powered()
        wire.send(FrameType.IDENTIFY, b"", READY_S)
        said.append([output.data for output in wire.unit.advance(READY_S + 1.0)])
    assert said[0] == said[1]
    everything = b"".join(said[0]) + json.dumps(wire.unit.flash_image()).encode()
    assert defective.defect is not None
    for word in (defective.category.value, defective.defect):
        assert word.encode() not in everything


def test_digital_truth_of_a_new_unit_is_faultless() -> None:
    assert HEALTHY.digital == DigitalTruth()
