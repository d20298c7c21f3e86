"""A rate gyro triad on a bench: its three voltages against closed form, and what it may be."""

import math

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.parameters import check_ranges
from dut_emulator.products.rate_gyro_triad import RateGyroUnit, make_unit
from dut_emulator.products.rate_gyro_triad.product import PRODUCT
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession, recorded
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.rate_table_model import RateTableModel
from dut_emulator.twin import Twin, parse_twin, twin_text
from protocol.bench_description import Site
from protocol.errors import TestloomError

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
K_V_PER_DEG_S = 0.050698
DEG_S = math.radians(1.0)
EARTH_DEG_S = math.degrees(7.292115e-5) * math.sin(math.radians(34.2))
OUTPUTS = ("OUT_X", "OUT_Y", "OUT_Z")


class ExactTable(RateTableModel):
    """The rate table without errors of its own."""

    effects = ()


def powered(*effects, table: RateTableModel | None = None, flash=None) -> RateGyroUnit:
    """A unit with only these effects, on from 0 s, level unless there is a table."""
    unit = make_unit(1, "U-1", flash, Twin("rate_gyro_triad", effects))
    unit.insert(table or LevelBoard(SITE), 0.0)
    unit.set_supply(15.0, 0.0)
    return unit


def test_an_ideal_unit_s_output_is_k_times_the_inertial_rate_at_any_moment_of_a_ramp() -> None:
    """0 to 100 °/s in 2 s; the mean over an aperture on a ramp is the value in its middle."""
    table = ExactTable(SITE, 1)
    table.home(0.0)
    table.tilt(2, 20.0)
    unit = powered(table=table)
    table.set_rate(100.0, 50.0, 30.0)
    for end_s, expected in ((29.9, 0.0), (30.5, 24.5), (31.2, 59.5), (40.0, 100.0)):
        mean = unit.mean_voltage_v("OUT_Y", end_s - 0.02, end_s)
        assert mean == pytest.approx(K_V_PER_DEG_S * (expected + EARTH_DEG_S), abs=1e-9)
    assert unit.point_voltage_v("OUT_Y", 40.1) == pytest.approx(K_V_PER_DEG_S * (100 + EARTH_DEG_S), abs=1e-9)
    assert unit.point_voltage_v("OUT_Q", 40.1) == 0.0


def test_a_reading_does_not_depend_on_who_looked_before() -> None:
    def readings(stops_s: list[float]) -> list[float]:
        table = RateTableModel(SITE, 1)
        table.home(0.0)
        unit = make_unit(3, "U-9")
        unit.insert(table, 0.0)
        unit.set_supply(15.0, 1.0)
        table.set_rate(-80.0, None, 15.0)
        for stop_s in stops_s:
            unit.advance(stop_s)
            unit.point_voltage_v("OUT_X", stop_s)
        return [unit.mean_voltage_v(point, 24.8, 25.0) for point in OUTPUTS]

    assert readings([]) == readings([1.0001, 1.3, 7.77, 15.0, 15.004, 20.0, 24.9])


def test_the_output_stage_has_an_end() -> None:
    table = ExactTable(SITE, 1)
    table.home(0.0)
    unit = powered(effect_named("gyro.saturation", range_si=10.8 / K_V_PER_DEG_S * DEG_S), table=table)
    for now_s, rate, expected in (
        (20.0, 205.0, 205.0 * K_V_PER_DEG_S),
        (45.0, -400.0, -10.8),
        (70.0, 1450.0, 10.8),
    ):
        table.set_rate(rate, 200.0, now_s)
        assert unit.mean_voltage_v("OUT_Z", now_s + 20.0, now_s + 20.1) == pytest.approx(expected, abs=3e-4)


def test_supply_moves_the_bias_from_the_moment_it_changes_and_below_brown_out_there_is_nothing() -> None:
    unit = powered(effect_named("gyro.supply_sensitivity", per_volt_si=(0.1 * DEG_S,) * 3, nominal_v=15.0))
    unit.set_supply(17.0, 2.5)
    at_rest = K_V_PER_DEG_S * EARTH_DEG_S
    assert unit.mean_voltage_v("OUT_Z", 2.4, 2.5) == pytest.approx(at_rest, abs=1e-9)
    assert unit.mean_voltage_v("OUT_Z", 2.6, 2.7) == pytest.approx(at_rest + 0.2 * K_V_PER_DEG_S, abs=1e-9)
    assert unit.supply_current_a(2.8) * 17.0 == pytest.approx(4.5)
    unit.set_supply(10.9, 3.0)
    assert unit.mean_voltage_v("OUT_Z", 2.9, 3.1) == unit.point_voltage_v("OUT_Z", 3.1) == 0.0
    assert unit.supply_current_a(3.2) == 0.0
    unit.set_supply(11.9, 3.3)
    assert unit.point_voltage_v("OUT_Z", 3.4) == 0.0
    unit.set_supply(12.0, 3.5)
    assert unit.point_voltage_v("OUT_Z", 3.6) != 0.0


def test_each_turn_on_has_a_bias_of_its_own() -> None:
    """0.01 °/s of standard deviation, and memory counts the turn-ons; without a bias there is none."""
    bias = effect_named("gyro.bias", bias_si=(0.5 * DEG_S, 0.0, 0.0))
    unit = powered(bias)
    levels = []
    for number in range(1, 151):
        levels.append([unit.point_voltage_v(point, number - 0.5) for point in OUTPUTS])
        unit.set_supply(0.0, number - 0.4)
        unit.set_supply(15.0, float(number))
    found = np.array(levels) / K_V_PER_DEG_S
    assert found.std() == pytest.approx(np.hypot(0.01, found.mean(axis=0).std()), rel=0.1)
    assert np.abs(found.mean(axis=0) - [0.5, 0.0, 0.0]).max() < 0.005 + EARTH_DEG_S
    image = unit.flash_image()
    assert image == {"power_cycles": 151}
    first, again = (powered(bias, flash=memory).point_voltage_v("OUT_X", 1.0) for memory in (None, image))
    assert first != again
    ideal = {powered(flash=memory).point_voltage_v("OUT_Z", 1.0) for memory in (None, image)}
    assert len(ideal) == 1


def test_the_mean_over_an_aperture_has_the_noise_of_its_length() -> None:
    """White noise of N averages to N / √T; the aperture is far longer than the samples."""
    density = 0.004
    unit = powered(effect_named("gyro.angle_random_walk", density_si_per_sqrt_hz=(density * DEG_S,) * 3))
    for start_s, aperture_s, count in ((1.0, 0.2, 1500), (302.0, 1.0, 400)):
        ends_s = start_s + aperture_s * np.arange(1, count + 1)
        means = [unit.mean_voltage_v("OUT_X", end_s - aperture_s, end_s) for end_s in ends_s.tolist()]
        expected = density * K_V_PER_DEG_S / math.sqrt(aperture_s)
        assert np.std(means) == pytest.approx(expected, rel=0.12)


def test_an_aperture_of_long_ago_is_refused() -> None:
    unit = powered()
    unit.advance(100.0)
    assert unit.mean_voltage_v("OUT_Z", 96.0, 98.0) == pytest.approx(K_V_PER_DEG_S * EARTH_DEG_S, abs=1e-9)
    with pytest.raises(TestloomError, match="long ago"):
        unit.mean_voltage_v("OUT_Z", 90.0, 91.0)


@pytest.mark.parametrize(("name", "sensor"), [("acc.bias", "acc"), ("link.frame_loss", "gyro")])
def test_what_analogue_gyros_cannot_have_is_refused(name: str, sensor) -> None:
    twin = Twin("rate_gyro_triad", (effect_named(name, sensor),))
    with pytest.raises(TestloomError, match=name):
        make_unit(1, "U-1", None, twin)
    with pytest.raises(TestloomError, match=name):
        recorded("rate_gyro_triad", "static", twin=twin)


def test_every_unit_drawn_lies_inside_the_catalogue_and_survives_its_file() -> None:
    units = [(seed, f"U-{serial:04d}") for seed in (1, 2, 3) for serial in range(60)]
    twins = [PRODUCT.twin(*unit) for unit in units if not PRODUCT.defects(*unit)]
    for twin in twins:
        for effect in twin.effects:
            check_ranges(effect, "a drawn unit")
    assert parse_twin(twin_text(twins[0])) == twins[0]
    assert PRODUCT.twin(1, "U-0005") == PRODUCT.twin(1, "U-0005") != PRODUCT.twin(2, "U-0005")
    scales = np.array([twin.effects[1].scale_factor_error for twin in twins])
    within_wafer = scales[:20].std(axis=0)
    assert (np.abs(scales) < 0.013).all()
    assert scales.std() > within_wafer.mean(), "lot and wafer add to what units differ by"
    belief = PRODUCT.believed(twins[0])["gyro"]
    np.testing.assert_allclose(np.diag(belief["matrix"]), 1 + scales[0], rtol=1e-12)
    assert belief["volts_per_unit"] == pytest.approx(K_V_PER_DEG_S)
    assert 200.0 < belief["range"] < 220.0


def test_a_recording_without_errors_is_the_motion_itself() -> None:
    """An ideal twin, whose neutral effects take the place of the table's errors: Earth rate in 10 µV."""
    exact = [effect_named(name, "gyro") for name in ("stand.remount_misalignment", "stand.wobble")]
    exact += [effect_named("stand.non_orthogonality", "gyro"), effect_named("stand.rate_scale_factor")]
    recording = recorded("rate_gyro_triad", "static", twin=Twin("", tuple(exact)), site=SITE)
    volts = recording.stream("dut").columns
    assert volts["volt_z"] == pytest.approx(round(K_V_PER_DEG_S * EARTH_DEG_S, 5), abs=1e-12)
    assert not volts["volt_x"].any()  # the stand's x axis points east


def test_a_recording_does_not_know_of_its_chunks() -> None:
    values = {"axis": 2.0, "cycles": 1.0, "dwell_s": 0.3, "settle_s": 0.1, "rest_s": 0.5}
    session = RecordingSession(RecordingOrder("rate_gyro_triad", "eleven_point", values, seed=6))
    cut, whole = (
        np.concatenate([chunk["dut"]["volt_y"] for _, chunk in session.chunks(size) if "dut" in chunk])
        for size in (97, 100_000)
    )
    np.testing.assert_array_equal(cut, whole)
