"""The MEMS attitude unit on its RS-422 link, and its sensors from unit to unit over temperature."""

import dataclasses
import json
import math
import struct

import numpy as np
import pytest

from dut_emulator.effects.catalogue import CATALOGUE, candidate
from dut_emulator.effects.deterministic import Bias, BiasTemperature
from dut_emulator.effects.effect import Stimulus
from dut_emulator.effects.fields_and_tones import HardIron
from dut_emulator.effects.link import FrameLoss
from dut_emulator.products.mems_ahrs import make_unit
from dut_emulator.products.mems_ahrs.compensation import Node, TriadCompensation
from dut_emulator.products.mems_ahrs.product import PRODUCT
from dut_emulator.products.mems_ahrs.unit_effects import draw_twin
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession, recorded
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.twin import Twin, parse_twin, twin_text
from protocol import mems_ahrs as rs422
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.frames import FrameBlock, FrameParser, encode_frame
from protocol.mems_ahrs import FrameType, ReplyStatus, SampleFlag, Sensor

SITE = Site(latitude_deg=39.96, gravity_m_s2=9.8013)
G = 9.80665


class Host:
    """A station's end of the link, with a unit on a level board; counts the bench's time."""

    def __init__(self, flash=None, twin=None, step_s=0.05, temperature_c=23.0) -> None:
        self.unit = make_unit(7, "U-0042", flash, twin)
        self.now_s, self.step_s = 100.0, step_s
        self.parser, self.samples, self.replies = FrameParser(), [], []
        self.unit.insert(LevelBoard(SITE, temperature_c=temperature_c), self.now_s)
        self.unit.set_supply(5.0, self.now_s)
        self.wait(1.0)

    def wait(self, duration_s: float) -> None:
        end_s = self.now_s + duration_s
        while self.now_s < end_s - 1e-12:
            self.now_s = min(self.now_s + self.step_s, end_s)
            for output in self.unit.advance(self.now_s):
                assert output.time_s <= self.now_s
                for item in self.parser.feed(output.data):
                    if item.type != FrameType.STREAM_SAMPLE:
                        self.replies += item.frames() if isinstance(item, FrameBlock) else [item]
                    else:
                        block = isinstance(item, FrameBlock)
                        self.samples.append(item.payloads.tobytes() if block else item.payload)

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        self.replies.clear()
        self.unit.receive("rs422", encode_frame(kind, 9, payload), self.now_s)
        self.wait(0.05)
        (reply,) = self.replies
        assert (reply.type, reply.sequence) == (kind | 0x80, 9)
        return reply.payload

    def stream(self, rate_hz: int, duration_s: float, compensated: bool = False) -> np.ndarray:
        self.samples.clear()
        assert (
            self.ask(FrameType.START_STREAM, struct.pack("<HB", rate_hz, compensated))[0] == ReplyStatus.DONE
        )
        self.wait(duration_s)
        assert self.ask(FrameType.STOP_STREAM)[0] == ReplyStatus.DONE
        return np.frombuffer(b"".join(self.samples), rs422.SAMPLE_DTYPE)


@pytest.mark.parametrize("rate_hz", rs422.STREAM_RATES_HZ)
def test_a_stream_is_what_it_says(rate_hz: int) -> None:
    samples = Host().stream(rate_hz, 4.0)
    assert len(samples) == pytest.approx(4.05 * rate_hz, abs=2)
    np.testing.assert_array_equal(samples["counter"], np.arange(len(samples)))
    assert (np.diff(samples["time_us"].astype(np.int64)) == 1_000_000 // rate_hz).all()
    force = samples["acc"].mean(axis=0) * rs422.ACC_LSB_G
    assert np.linalg.norm(force) == pytest.approx(SITE.gravity_m_s2 / G, abs=0.02)
    tilt = samples["attitude"][-1, :2] * rs422.ATTITUDE_LSB_DEG
    level = (math.degrees(math.atan2(force[1], force[2])), math.degrees(math.asin(force[0])))
    np.testing.assert_allclose(tilt, level, atol=0.1)
    assert samples["flags"][-1] == SampleFlag.STEADY | SampleFlag.ALIGNED


def test_bytes_do_not_depend_on_how_time_is_cut() -> None:
    coarse, fine = (Host(step_s=step_s).stream(100, 3.0) for step_s in (1.0, 0.003))
    shared = min(len(coarse), len(fine))
    assert shared > 290
    np.testing.assert_array_equal(coarse[:shared], fine[:shared])


def test_what_is_asked_is_answered() -> None:
    host = Host()
    status, serial, version, _ = rs422.IDENTITY_LAYOUT.unpack(host.ask(FrameType.IDENTIFY))
    assert (status, serial.rstrip(b"\0"), bool(version.rstrip(b"\0"))) == (0, b"U-0042", True)
    assert host.ask(FrameType.ECHO, b"abc") == b"\0abc"
    assert host.ask(0x1F)[0] == ReplyStatus.UNKNOWN
    for kind, payload in (
        (FrameType.START_STREAM, struct.pack("<HB", 400, 0)),
        (FrameType.START_STREAM, b"\0"),
        (FrameType.READ_NODE, b"\0\0"),
        (FrameType.WRITE_NODE, rs422.NODE_LAYOUT.pack(0, 1, 25.0, *[0.0] * 9)),
        (FrameType.WRITE_COEFFICIENTS, rs422.COEFFICIENTS_LAYOUT.pack(0, *[0.0] * 12)),
        (FrameType.ERASE_NODES, b"\7"),
    ):
        assert host.ask(kind, payload)[0] == ReplyStatus.INVALID
    host.unit.receive("rs422", b"\xeb\x90garbage", host.now_s)
    host.wait(0.1)
    assert host.ask(FrameType.IDENTIFY)[0] == ReplyStatus.DONE


def test_it_warms_up_by_what_it_draws() -> None:
    host = Host(step_s=1.0)
    idle_a = host.unit.supply_current_a(host.now_s)
    host.wait(800.0)
    idle = rs422.STATUS_LAYOUT.unpack(host.ask(FrameType.STATUS))
    host.ask(FrameType.START_STREAM, struct.pack("<HB", 200, 0))
    busy_a = host.unit.supply_current_a(host.now_s)
    host.wait(500.0)
    busy = rs422.STATUS_LAYOUT.unpack(host.ask(FrameType.STATUS))
    assert busy_a > idle_a > 0.05
    for found, current_a in ((idle, idle_a), (busy, busy_a)):
        hottest, gyros, accs, case = found[4:8]
        assert case - 23.0 == pytest.approx(5.0 * current_a / 3.57, rel=0.02), "heat leaves through 3.57 W/K"
        assert hottest > gyros > case
        assert hottest > accs > case
    assert busy[4] - 23.0 == pytest.approx(7.8, rel=0.1), "paper 2, measured with paste: at most 8 K"
    assert math.isnan(idle[8])
    assert abs(busy[8]) < 1.0


def test_too_hot_is_said() -> None:
    host = Host(step_s=1.0, temperature_c=76.0)
    samples = host.stream(200, 250.0)
    hot = SampleFlag.BEYOND_CALIBRATED | SampleFlag.OVER_TEMPERATURE
    assert samples["flags"][-1] & hot == hot
    assert not samples["flags"][0] & SampleFlag.OVER_TEMPERATURE
    components = rs422.STATUS_LAYOUT.unpack(host.ask(FrameType.STATUS))[2]
    assert components == rs422.Component.GYROS | rs422.Component.ACCELEROMETERS


def test_a_written_table_corrects_and_survives_the_power() -> None:
    host = Host()
    matrix, bias = np.eye(3) * 1.01, (0.001, -0.002, 0.003)
    assert host.ask(
        FrameType.WRITE_COEFFICIENTS, rs422.COEFFICIENTS_LAYOUT.pack(Sensor.GYRO, *matrix.ravel(), *bias)
    ) == bytes((ReplyStatus.DONE,))
    rows = [(20.0, [0.0] * 9), (25.0, [0.0, 0.0, 0.01] * 3), (30.0, [0.0, 0.0, 0.02] * 3)]
    for index, (temperature_c, numbers) in enumerate(rows):
        packed = rs422.NODE_LAYOUT.pack(Sensor.GYRO, index, temperature_c, *numbers)
        assert host.ask(FrameType.WRITE_NODE, packed)[0] == ReplyStatus.DONE
        assert host.ask(FrameType.READ_NODE, bytes((Sensor.GYRO, index))) == b"\0" + packed
    descending = rs422.NODE_LAYOUT.pack(Sensor.GYRO, 1, 40.0, *[0.0] * 9)
    assert host.ask(FrameType.WRITE_NODE, descending)[0] == ReplyStatus.INVALID
    flash = json.loads(json.dumps(host.unit.flash_image()))
    again = Host(flash=flash)
    raw, corrected = again.stream(100, 3.0), again.stream(100, 3.0, compensated=True)
    quantum = math.radians(rs422.GYRO_LSB_DEG_S)
    sigma = 0.002 * (corrected["temp_gyro"].mean() * 0.01 - 20.0)
    expected = 1.01 * (raw["gyro"].mean(axis=0) * quantum - sigma - np.array(bias))
    np.testing.assert_allclose(corrected["gyro"].mean(axis=0) * quantum, expected, atol=math.radians(0.02))
    assert corrected["flags"][-1] & SampleFlag.COMPENSATED
    assert not raw["flags"][-1] & SampleFlag.COMPENSATED
    assert again.ask(FrameType.ERASE_NODES, bytes((Sensor.GYRO,)))[0] == ReplyStatus.DONE
    assert again.unit.flash_image()["triads"]["GYRO"]["nodes"] == []
    with pytest.raises(TestloomError, match="flash image"):
        make_unit(1, "U-1", {"format": "testloom-flash/1", "product": "fog"})


def test_reset_and_brown_out_end_a_stream() -> None:
    host = Host()
    host.ask(FrameType.START_STREAM, struct.pack("<HB", 100, 0))
    host.wait(1.0)
    assert host.ask(FrameType.RESET)[0] == ReplyStatus.DONE
    host.wait(1.0)
    count = len(host.samples)
    host.wait(1.0)
    assert len(host.samples) == count, "silent after a reset"
    host.unit.set_supply(4.0, host.now_s)
    assert host.unit.supply_current_a(host.now_s) == 0.0
    host.unit.receive("rs422", encode_frame(FrameType.IDENTIFY, 1, b""), host.now_s)
    host.wait(0.5)
    assert host.unit.flash_image()["power_cycles"] == 1


def test_the_table_of_the_vectors_compensates_as_they_say() -> None:
    """Paper 2's oracle unit at 70 °C: N = (0.6429, −0.3177, 0.7879) g back to (0.6, −0.3, 0.74) g, 0.02 mg.

    K, D, the coefficients at 70 °C and N are those of the published vector; a node at 60 °C of zeros makes
    65 °C half of them.
    """
    room = np.array([[1.002, 0.003, -0.001], [-0.002, 0.998, 0.004], [0.0015, -0.0025, 1.001]])
    at_70 = (
        *(0.000973479, 0.008845148, 0.017216492),
        *(-0.000816421, -0.00683273, -0.007124755),
        *(0.00049331, 0.004438106, 0.011738065),
    )
    nodes = (Node(60.0, (0.0,) * 9), Node(70.0, at_70))
    inverse = tuple(np.linalg.inv(room).ravel().tolist())
    table = TriadCompensation(inverse, (0.02, -0.015, 0.03), nodes)
    output = np.array([[0.642865512, -0.317676802, 0.787931326]])
    np.testing.assert_allclose(table.apply(output, np.array([70.0])), [[0.6, -0.3, 0.74]], atol=1e-6)
    np.testing.assert_array_equal(
        table.apply(output, np.array([85.0])), table.apply(output, np.array([70.0])), "held beyond the end"
    )
    corrections = table.apply(np.repeat(output, 3, 0), np.array([60.0, 65.0, 70.0]))
    np.testing.assert_allclose(corrections[1], corrections[[0, 2]].mean(axis=0), atol=1e-12)


def bias_at(twin: Twin, sensor: str, temperature_c: np.ndarray) -> np.ndarray:
    """(n, 3) bias over temperature by the polynomial of the twin, by hand."""
    (found,) = (e for e in twin.effects if isinstance(e, BiasTemperature) and e.sensor == sensor)
    excess = temperature_c[:, np.newaxis] - 25.0
    return sum(np.array(row) * excess**k for k, row in enumerate(found.coefficients_si_per_c, start=1))


def test_units_differ_most_of_all_over_temperature() -> None:
    """Tens of mdeg/s and of mg over the span (the magnitudes of MEMS), bent, each unit in its own way."""
    at_c = np.linspace(-40.0, 80.0, 25)
    twins = [draw_twin(3, f"U-{number:04d}") for number in range(60)]
    for sensor, low, high in (("gyro", math.radians(0.01), math.radians(0.5)), ("acc", 5e-3 * G, 100e-3 * G)):
        curves = np.array([bias_at(twin, sensor, at_c) for twin in twins])
        spans = np.ptp(curves, axis=1)
        assert low < np.median(spans) < high
        flat = curves.transpose(1, 0, 2).reshape(25, -1)
        line = np.stack([np.polyval(fit, at_c) for fit in np.polyfit(at_c, flat, 1).T], axis=1)
        assert np.median(np.abs(flat - line).max(axis=0) / np.ptp(flat, axis=0)) > 0.1, "far from a line"
        means = curves.mean(axis=0)
        assert np.median(np.std(curves, axis=0).max(axis=0) / np.abs(means).max(axis=0)) > 0.5
    assert draw_twin(3, "U-0007") == twins[7]
    assert parse_twin(twin_text(twins[7])) == twins[7], "and every parameter is in its range"


def test_one_wafer_is_more_alike_than_two() -> None:
    def bend(number: int) -> float:
        return float(bias_at(draw_twin(5, f"U-{number:04d}"), "acc", np.array([80.0]))[0, 0])

    wafers = np.array([[bend(24 * wafer + place) for place in range(8)] for wafer in range(20)])
    within = wafers.var(axis=1, ddof=1).mean()
    between = wafers.mean(axis=1).var(ddof=1) - within / 8
    # variance components 0.8² to 0.45² of each power
    assert between / within == pytest.approx((0.45 / 0.8) ** 2, rel=0.8)


def test_what_is_believed_is_the_twin_as_far_as_the_format_goes() -> None:
    twin = draw_twin(1, "U-0001")
    believed = PRODUCT.believed(twin)
    (bias,) = (e for e in twin.effects if isinstance(e, Bias) and e.sensor == "acc")
    np.testing.assert_allclose(np.array(believed["acc"]["bias"]) * G, bias.bias_si, rtol=1e-12)
    assert believed["gyro"]["range"] == pytest.approx(400.0)
    assert believed["acc"]["quantum"] == pytest.approx(0.3125e-3)
    assert believed["gyro"]["bandwidth_hz"] == pytest.approx(80.0, rel=0.2)
    assert believed["earth_rate"] is True


def test_other_sensors_are_refused_and_lost_frames_are_gaps() -> None:
    with pytest.raises(TestloomError, match="has no mag"):
        make_unit(1, "U-1", twin=Twin("mems_ahrs", (HardIron("mag"),)))
    with pytest.raises(TestloomError, match="one of a fog"):
        make_unit(1, "U-1", twin=Twin("fog"))
    lossy = draw_twin(7, "U-0042").with_effect(FrameLoss("gyro", 0.3))
    samples = Host(twin=lossy).stream(100, 5.0)
    steps = np.diff(samples["counter"].astype(int))
    assert samples["counter"][-1] + 1 > len(samples)
    assert (steps > 1).mean() == pytest.approx(0.3, abs=0.1)
    assert np.abs(samples["attitude"][:, :2]).max() * rs422.ATTITUDE_LSB_DEG < 2.0, (
        "the firmware lost nothing"
    )


class TurningBoard(LevelBoard):
    """A level board that turns about z up, 90 deg/s to the left."""

    def stimulus(self, times_s: np.ndarray) -> Stimulus:
        level = super().stimulus(times_s)
        assert level.rate_rad_s is not None
        return dataclasses.replace(level, rate_rad_s=level.rate_rad_s + np.radians([0.0, 0.0, 90.0]))


def test_a_turn_to_the_left_is_seen_on_the_link() -> None:
    host = Host()
    host.unit.set_supply(0.0, host.now_s)
    host.unit.insert(TurningBoard(SITE), host.now_s)
    host.unit.set_supply(5.0, host.now_s)
    host.wait(1.0)
    samples = host.stream(200, 1.0)
    assert samples["gyro"][:, 2].mean() * rs422.GYRO_LSB_DEG_S == pytest.approx(90.0, rel=0.03)
    turned = np.unwrap(np.radians(samples["attitude"][:, 2] * rs422.ATTITUDE_LSB_DEG))
    span_s = (samples["time_us"][-1] - samples["time_us"][0]) * 1e-6
    assert np.degrees(turned[-1] - turned[0]) / span_s == pytest.approx(-90.0, rel=0.03)
    assert not samples["flags"][-1] & SampleFlag.STEADY


def test_a_frame_of_the_stream_is_what_the_layout_says() -> None:
    assert rs422.SAMPLE_DTYPE.itemsize == 4 + 8 + 6 + 6 + 6 + 6 + 2


def test_a_twin_may_have_any_effect_of_its_sensors_and_keeps_its_attitude() -> None:
    base = draw_twin(1, "U-0001")
    for name, (_, sensors) in CATALOGUE.items():
        for sensor in {"gyro", "acc", "temperature"} & set(sensors):
            if name.endswith("flicker_noise"):
                continue  # another form of the bias instability that the twin has
            twin = base.with_effect(candidate(name, sensor))
            dut = (
                recorded("mems_ahrs", "static", values={"duration_s": 1.0}, twin=twin).streams["dut"].columns
            )
            tilt = np.abs(np.stack([dut["roll"], dut["pitch"]]))
            assert tilt.max() < 5.0, name


def test_a_unit_that_was_powered_before_is_warm_and_asking_twice_gives_nothing_more() -> None:
    order = RecordingOrder("mems_ahrs", "static", values={"duration_s": 2.0}, powered_before_s=3600.0)
    session = RecordingSession(order)
    streams = PRODUCT.begin(session.unit)
    first = streams.advance(1.0)["dut"]
    assert len(first["t"]) == 201
    assert first["temp_gyro"].mean() == pytest.approx(23.0 + 5.65, abs=0.1)
    assert all(len(column) == 0 for column in streams.advance(1.0)["dut"].values())
    assert streams.advance(2.0)["dut"]["counter"][0] == 201
