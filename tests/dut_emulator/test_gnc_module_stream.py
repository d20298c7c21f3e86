"""Raw and compensated streams: counts, instants, physics on the turntable, saturation."""

import dataclasses
import math

import numpy as np
import pytest

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.products.gnc_module import GncModule
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import TriadTruth, UnitTruth
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.three_axis_turntable import ThreeAxisTurntableModel
from protocol import gnc_module as product
from protocol.bench_description import Site
from protocol.frames import Frame, FrameParser, encode_frame
from protocol.gnc_module import SAMPLE_DTYPE, FrameType, SampleStatus

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
UNIT = draw_unit(7, "GM-0002")
START_S = 60.0
GYRO_LSB = math.radians(product.GYRO_LSB_DEG_S)
ACC_LSB = product.ACC_LSB_G * 9.80665
ZERO = (0.0, 0.0, 0.0)


def quiet(triad: TriadTruth) -> TriadTruth:
    """The triad without noise, warmth or anything that a power-on draws anew."""
    return dataclasses.replace(
        triad,
        turn_on_deviation_si=0.0,
        noise_density_si=ZERO,
        bias_instability_si=ZERO,
        bias_temperature_si_per_c=ZERO,
    )


def without_noise(truth: UnitTruth) -> UnitTruth:
    return dataclasses.replace(truth, gyro=quiet(truth.gyro), acc=quiet(truth.acc))


def streaming(
    truth: UnitTruth, surroundings: object, rate_hz: int = 200, *, compensated: bool = False
) -> GncModule:
    """A unit that has been on since 0 s and streams since `START_S`."""
    unit = GncModule(truth)
    unit.insert(surroundings, 0.0)  # type: ignore[arg-type]
    unit.set_supply(5.0, 0.0)
    unit.advance(START_S)
    payload = product.START_STREAM_LAYOUT.pack(rate_hz, int(compensated))
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, payload), START_S)
    return unit


def stop(unit: GncModule, now_s: float) -> None:
    unit.receive("rs422", encode_frame(FrameType.STOP_STREAM, 2, b""), now_s)


def frames_of(unit: GncModule, to_s: float) -> list[Frame]:
    parser = FrameParser()
    found = [item for o in unit.advance(to_s) if o.link == "rs422" for item in parser.feed(o.data)]
    assert parser.statistics.dropped_bytes == 0
    return [frame for item in found for frame in ((item,) if isinstance(item, Frame) else item.frames())]


def samples_of(unit: GncModule, to_s: float) -> np.ndarray:
    payloads = [f.payload for f in frames_of(unit, to_s) if f.type == FrameType.STREAM_SAMPLE]
    return np.frombuffer(b"".join(payloads), SAMPLE_DTYPE)


def matrix_of(triad: TriadTruth) -> np.ndarray:
    """M of y = M u + b: scale after misalignment."""
    return np.diag(1 + np.array(triad.scale_factor_error)) @ (np.eye(3) + np.array(triad.misalignment_rad))


@pytest.mark.parametrize("rate_hz", product.STREAM_RATES_HZ)
def test_rate_counters_and_sequence(rate_hz: int) -> None:
    unit = streaming(UNIT, LevelBoard(SITE), rate_hz)
    stop(unit, START_S + 10.001)
    frames = frames_of(unit, START_S + 11.0)
    stream = [frame for frame in frames if frame.type == FrameType.STREAM_SAMPLE]
    assert len(stream) == 10 * rate_hz
    assert [frame.sequence for frame in stream] == [number % 256 for number in range(len(stream))]
    # the reply to STOP comes after the last sample, the one to START before the first
    assert [frames[0].type, frames[-1].type] == [0x83, 0x84]
    rows = np.frombuffer(b"".join(frame.payload for frame in stream), SAMPLE_DTYPE)
    np.testing.assert_array_equal(rows["counter"], np.arange(len(rows)))
    period_us = 1e6 / rate_hz
    np.testing.assert_allclose(np.diff(rows["time_us"].astype(float)), period_us, atol=1.0)


def test_a_stream_ends_with_its_stop_and_begins_anew() -> None:
    unit = streaming(UNIT, LevelBoard(SITE))
    stop(unit, START_S + 1.0)
    assert len(samples_of(unit, START_S + 5.0)) == 199
    payload = product.START_STREAM_LAYOUT.pack(50, 0)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 3, payload), START_S + 5.0)
    rows = samples_of(unit, START_S + 7.1)
    assert rows["counter"][0] == 0
    assert np.diff(rows["time_us"])[0] == 20_000


def test_time_and_rate_are_the_crystals() -> None:
    slow = dataclasses.replace(UNIT, crystal_error=-0.01)
    unit = streaming(slow, LevelBoard(SITE))
    rows = samples_of(unit, START_S + 100.0)
    assert len(rows) == pytest.approx(0.99 * 20_000, abs=55)  # a block may be on its way
    assert rows["time_us"][0] == pytest.approx(0.99 * START_S * 1e6 + 5000, abs=600)
    np.testing.assert_allclose(np.diff(rows["time_us"].astype(float)), 5000, atol=1.0)


def test_blocks_are_timed_by_their_last_sample() -> None:
    unit = streaming(UNIT, LevelBoard(SITE))
    for output in unit.advance(START_S + 5.0):
        if output.link == "rs422" and len(output.data) > 100:
            (item,) = FrameParser().feed(output.data)
            last = np.frombuffer(item.payloads[-1].tobytes(), SAMPLE_DTYPE)[0]
            unit_s = output.time_s * (1 + UNIT.crystal_error)
            assert last["time_us"] == pytest.approx(unit_s * 1e6, abs=1.0)
    due_s = unit.next_event_s()
    assert due_s is not None
    assert START_S + 5.0 < due_s < START_S + 5.3


def test_a_turn_on_the_table_by_hand() -> None:
    table = ThreeAxisTurntableModel(SITE)
    table.home(0.0)
    unit = streaming(without_noise(UNIT), table)
    table.rotate("outer", 1080.0, 5.0, 2.2, START_S + 1.0)
    rows = samples_of(unit, START_S + 7.1)
    cruise = rows["gyro"][int(3.4 * 200) : int(3.6 * 200)].mean(axis=0) * GYRO_LSB
    latitude = math.radians(34.2)
    up = 7.292115e-5 * math.sin(latitude)  # the horizontal part turns with the table: below a quantum
    expected = matrix_of(UNIT.gyro) @ [0, 0, math.radians(1080 / 2.8) + up] + UNIT.gyro.bias_si
    np.testing.assert_allclose(cruise, expected, atol=7e-5)
    turned = (rows["gyro"] * GYRO_LSB - np.array(UNIT.gyro.bias_si)).sum(axis=0) * 0.005
    np.testing.assert_allclose(np.linalg.solve(matrix_of(UNIT.gyro), turned), [0, 0, 6 * math.pi], atol=2e-3)
    assert not (rows["status"] & SampleStatus.GYRO_SATURATED).any()


@pytest.mark.parametrize("angles_deg", [(0.0, -90.0, 0.0), (0.0, 0.0, 90.0), (30.0, 20.0, -40.0)])
def test_compensated_output_gives_the_input_back(angles_deg: tuple[float, float, float]) -> None:
    table = ThreeAxisTurntableModel(SITE)
    now = table.home(0.0)
    table.move(angles_deg, now)  # type: ignore[arg-type]
    truth = without_noise(UNIT)
    unit = GncModule(truth)
    unit.insert(table, 0.0)
    unit.set_supply(5.0, 0.0)
    for sensor, triad in enumerate((truth.gyro, truth.acc)):
        inverse = np.linalg.inv(matrix_of(triad)).ravel()
        payload = product.COEFFICIENTS_LAYOUT.pack(sensor, *inverse, *triad.bias_si)
        unit.receive("rs422", encode_frame(FrameType.WRITE_COEFFICIENTS, 1, payload), START_S)
    payload = product.START_STREAM_LAYOUT.pack(200, 1)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, payload), START_S)
    rows = samples_of(unit, START_S + 1.1)
    acting = table.stimulus(np.array([START_S]))
    # two roundings to whole quanta, the first through the matrix
    np.testing.assert_allclose(rows["acc"][50] * ACC_LSB, acting.specific_force_m_s2[0], atol=1.2 * ACC_LSB)
    np.testing.assert_allclose(rows["gyro"][50] * GYRO_LSB, acting.rate_rad_s[0], atol=1.2 * GYRO_LSB)
    assert (rows["status"] & SampleStatus.COMPENSATED).all()


class Spinning:
    """Constant input, whatever it is."""

    def __init__(
        self, rate_rad_s: tuple[float, float, float], force_m_s2: tuple[float, float, float]
    ) -> None:
        self.acting = rate_rad_s, force_m_s2

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """None: it does what it says."""
        return ()

    def stimulus(self, times_s: np.ndarray) -> Stimulus:
        rate, force = (np.tile(value, (len(times_s), 1)) for value in self.acting)
        return Stimulus(
            times_s,
            np.full(len(times_s), 23.0),
            math.nan,
            rate_rad_s=rate,
            specific_force_m_s2=force,
            field_t=np.zeros_like(rate),
        )


def test_saturation_is_said() -> None:
    limits = product.GYRO_RANGE_DEG_S / product.GYRO_LSB_DEG_S, product.ACC_RANGE_G / product.ACC_LSB_G
    rows = samples_of(streaming(UNIT, Spinning((10.0, 0.0, -10.0), (0.0, 600.0, 0.0))), START_S + 1.0)
    assert (rows["gyro"][:, 0] == limits[0]).all()
    assert (rows["gyro"][:, 2] == -limits[0]).all()
    assert (rows["acc"][:, 1] == limits[1]).all()
    assert (rows["status"] == SampleStatus.GYRO_SATURATED | SampleStatus.ACC_SATURATED).all()
    rows = samples_of(streaming(UNIT, Spinning((6.0, 0.0, 0.0), (0.0, 0.0, 9.8))), START_S + 1.0)
    assert (rows["status"] == 0).all()


def test_a_dead_axis_says_zero() -> None:
    dead = next(u for u in (draw_unit(1, f"D-{n}") for n in range(2000)) if u.defect == "dead_gyro_axis")
    axis = "xyz".index(dead.affected[0][-1])
    rows = samples_of(streaming(dead, Spinning((1.0, 1.0, 1.0), (0.0, 0.0, 9.8))), START_S + 1.0)
    assert not rows["gyro"][:, axis].any()
    assert (np.delete(rows["gyro"], axis, axis=1) > 0).all()


def test_noise_at_rest_is_the_truths() -> None:
    rows = samples_of(streaming(UNIT, LevelBoard(SITE)), START_S + 60.0)
    for name, lsb in (("gyro", GYRO_LSB), ("acc", ACC_LSB)):
        deviation = np.diff(rows[name] * lsb, axis=0).std(axis=0) / math.sqrt(2)
        expected = [
            math.hypot(UNIT.measurands[f"{name}_noise_{axis}"], lsb / math.sqrt(12)) for axis in "xyz"
        ]
        np.testing.assert_allclose(deviation, expected, rtol=0.05)


def test_two_power_ons_differ_by_the_turn_on_bias_and_their_noise() -> None:
    unit = GncModule(UNIT)
    unit.insert(LevelBoard(SITE), 0.0)
    means = []
    for run in range(2):
        now = 1000.0 * run
        unit.set_supply(5.0, now)
        unit.advance(now + START_S)
        payload = product.START_STREAM_LAYOUT.pack(200, 0)
        unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, payload), now + START_S)
        rows = samples_of(unit, now + START_S + 30.0)
        means.append(rows["gyro"].mean(axis=0) * GYRO_LSB)
        unit.set_supply(0.0, now + START_S + 30.0)
    difference = np.degrees(means[1] - means[0]) * 3600
    assert (np.abs(difference) > 0.01).all()
    assert (np.abs(difference) < 60.0).all()  # turn-on 3 °/h, bias instability 5 °/h, noise 2 °/h, both runs
