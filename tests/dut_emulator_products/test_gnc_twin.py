"""A GNC module as effects: one physics whether recorded or live, any twin, a lot with parts in common."""

import dataclasses
import json
import math
from itertools import pairwise

import numpy as np
import pytest

from dut_emulator.effects.effect import Stimulus
from dut_emulator.effects.fields_and_tones import HardIron, SoftIron
from dut_emulator.effects.link import FrameLoss
from dut_emulator.products.gnc_module import GncModule, make_unit
from dut_emulator.products.gnc_module.belief import believed_of
from dut_emulator.products.gnc_module.inertial_sensors import InertialSensors
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.product import PRODUCT
from dut_emulator.products.gnc_module.unit_truth import Category
from dut_emulator.products.gnc_module.unit_twin import SensorUnit, crystal_error, twin_of
from dut_emulator.products.product import UnitOnStand
from dut_emulator.stands.catalogue import recording_stand
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.twin import Twin, parse_twin, twin_text
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.frames import FrameBlock, FrameParser, encode_frame
from protocol.gnc_module import SAMPLE_DTYPE, START_STREAM_LAYOUT, FrameType

ZERO = (0.0, 0.0, 0.0)
SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
HEALTHY = next(
    unit for unit in (draw_unit(7, f"GM-{n:04d}") for n in range(1, 99)) if unit.category is Category.HEALTHY
)


def test_a_twin_file_gives_the_unit_back() -> None:
    for serial in (f"GM-{number:04d}" for number in range(1, 40)):
        twin = PRODUCT.twin(7, serial)
        assert parse_twin(twin_text(twin)) == twin
        assert {effect.sensor for effect in twin.effects} == {"gyro", "acc", "mag", "gnss"}
    assert PRODUCT.twin(7, "GM-0001") == PRODUCT.twin(7, "GM-0001") != PRODUCT.twin(8, "GM-0001")


def test_wafer_and_lot_are_in_the_temperature_coefficients() -> None:
    """Scale factor over temperature, 40 ppm/°C of each unit's own: wafers differ by 40, lots by 50 more."""

    def coefficient(seed: int, number: int) -> float:
        return draw_unit(seed, f"GM-{number:04d}").gyro.scale_factor_temperature_per_c[0] * 1e6

    lots = np.array([[coefficient(seed, n) for n in range(24, 48)] for seed in range(40)])  # a wafer of each
    assert lots.std(axis=1).mean() == pytest.approx(40.0, rel=0.1)
    between = math.hypot(40.0, 50.0, 40.0 / math.sqrt(24))
    assert lots.mean(axis=1).std() == pytest.approx(between, rel=0.3)


def still(field_t: np.ndarray, temperature_c: float, n: int) -> Stimulus:
    times = np.arange(n) / 200.0
    zero = np.zeros((n, 3))
    return Stimulus(
        times,
        np.full(n, temperature_c),
        math.nan,
        rate_rad_s=zero,
        specific_force_m_s2=zero,
        field_t=np.tile(field_t, (n, 1)),
    )


def magnetometer(twin: Twin, field_t: np.ndarray, temperature_c: float = 25.0, n: int = 8000) -> np.ndarray:
    """Mean counts of a magnetometer without warmth, in tesla."""
    sensors = InertialSensors(SensorUnit(twin, 0.0, 0.0, 0.0, 0.0), np.random.SeedSequence(1), 0.0)
    counts = sensors.sample(np.arange(n) / 200.0, 1 / 200.0, still(field_t, temperature_c, n)).mag
    return counts * 120e-10  # 120 µgauss


def test_the_magnetometer_by_hand() -> None:
    truth = HEALTHY.magnetometer
    field = np.array([20e-6, -10e-6, 43e-6])
    soft = np.array(truth.soft_iron)
    expected = (1 + np.array(truth.scale_factor_error)) * (field + soft @ field) + truth.bias_t
    seen = magnetometer(twin_of(HEALTHY), field)
    np.testing.assert_allclose(seen.mean(axis=0), expected, atol=3e-9)
    np.testing.assert_allclose(seen.std(axis=0), math.hypot(5e-8, 120e-10 / math.sqrt(12)), rtol=0.04)
    warm = magnetometer(twin_of(HEALTHY), field, 65.0).mean(axis=0) - expected
    slope = np.array(truth.scale_factor_temperature_per_c) * 40
    np.testing.assert_allclose(warm, slope * (expected - truth.bias_t), atol=3e-9)
    strong = magnetometer(twin_of(HEALTHY), np.array([1e-3, -1e-3, 0.0]), n=10)
    np.testing.assert_allclose(strong[:, 0], 6e-4)  # ±6 gauss
    np.testing.assert_allclose(strong[:, 1], -6e-4)


def test_belief_is_the_twins_matrix_and_bias() -> None:
    twin = Twin(
        "gnc_module",
        (SoftIron("mag", ((0.0, 0.01, 0.0), ZERO, ZERO)), HardIron("mag", (1e-5, 0.0, -2e-5))),
    )
    said = believed_of(twin)
    assert said["mag"]["matrix"] == [[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(said["mag"]["bias"], [0.1, 0.0, -0.2])
    full = believed_of(twin_of(HEALTHY))
    assert json.loads(json.dumps(full)) == full
    density = math.degrees(math.sqrt(np.mean(np.square(HEALTHY.gyro.noise_density_si)))) * 60
    assert full["gyro"]["angle_random_walk"]["value"] == pytest.approx(density)
    assert full["gyro"]["quantum"] == 0.0025
    assert full["acc"]["range"] == 50.0


def on_stand(twin: Twin, profile: str = "satellite_static", **given: float) -> UnitOnStand:
    stand = recording_stand(PRODUCT.profiles[profile].stand, 1, SITE)
    values = {"duration_s": 20.0, "satellites": 12.0, "power_dbm": -130.0} | given
    return UnitOnStand(
        twin, stand.effects, stand.run(profile, values), 200.0, np.random.SeedSequence(4), "U-1"
    )


def test_a_recording_does_not_depend_on_its_pieces() -> None:
    unit = on_stand(twin_of(HEALTHY), duration_s=40.0)
    whole, pieces = PRODUCT.begin(unit), PRODUCT.begin(unit)
    once = whole.advance(40.0)
    parts = [pieces.advance(t) for t in (0.0, 0.003, 1.7, 22.22, 30.0, 40.0)]
    assert [shape.name for shape in whole.shapes] == ["dut", "gnss"]
    for shape in whole.shapes:
        assert set(once[shape.name]) == set(shape.units) == set(shape.types)
        for column, values in once[shape.name].items():
            assert values.dtype == shape.types[column]
            joined = np.concatenate([part[shape.name][column] for part in parts])
            np.testing.assert_array_equal(joined, values, err_msg=f"{shape.name}.{column}")


def test_the_unit_counts_by_its_own_crystal() -> None:
    twin = twin_of(dataclasses.replace(HEALTHY, crystal_error=1e-3))
    assert crystal_error(twin) == 1e-3
    sent = PRODUCT.begin(on_stand(twin)).advance(20.0)["dut"]
    assert len(sent["t"]) == 20 * 200 + 4 + 1  # 20 s last 20.02 s by its clock
    np.testing.assert_allclose(np.diff(sent["t"]), 0.005, atol=1e-12)


def test_lost_frames_leave_holes_that_the_counter_tells() -> None:
    twin = Twin("gnc_module", (FrameLoss("acc", 0.2),))
    sent = PRODUCT.begin(on_stand(twin)).advance(20.0)["dut"]
    assert abs(len(sent["t"]) / 4001 - 0.8) < 0.03
    np.testing.assert_allclose(sent["t"], sent["counter"] / 200)
    assert np.isfinite(sent["acc_z"]).all()
    unit = make_unit(7, "GM-0002", twin=twin)
    unit.insert(LevelBoard(SITE), 0.0)
    unit.set_supply(5.0, 0.0)
    unit.advance(2.0)
    start = START_STREAM_LAYOUT.pack(200, 0)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, start), 2.0)
    data = b"".join(output.data for output in unit.advance(12.0) if output.link == "rs422")
    items = [item for item in FrameParser().feed(data) if isinstance(item, FrameBlock)]
    rows = np.concatenate([item.payloads for item in items]).view(SAMPLE_DTYPE).ravel()
    assert rows["counter"][-1] > 1900
    assert 0.7 < len(rows) / rows["counter"][-1] < 0.85
    assert all(b > a for a, b in pairwise(rows["counter"].tolist()))


def test_a_live_unit_with_a_twin_says_what_the_recorded_one_does() -> None:
    """The same means, from a server's unit on the simulator's bench and from a recording of it."""
    twin = twin_of(HEALTHY)
    sent = PRODUCT.begin(on_stand(twin)).advance(20.0)["dut"]
    unit = GncModule(draw_unit(7, "GM-0001"), twin=twin)
    unit.insert(LevelBoard(SITE), 0.0)
    unit.set_supply(5.0, 0.0)
    unit.advance(2.0)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, START_STREAM_LAYOUT.pack(200, 0)), 2.0)
    data = b"".join(output.data for output in unit.advance(22.0) if output.link == "rs422")
    items = [item for item in FrameParser().feed(data) if isinstance(item, FrameBlock)]
    rows = np.concatenate([item.payloads for item in items]).view(SAMPLE_DTYPE).ravel()
    for sensor, lsb, bound in (("gyro", 0.0025, 0.02), ("acc", 0.0005, 5e-4), ("mag", 120e-6, 3e-4)):
        live = rows[sensor].mean(axis=0) * lsb
        recorded = np.array([sent[f"{sensor}_{axis}"].mean() for axis in "xyz"])
        np.testing.assert_allclose(live, recorded, atol=bound)


def test_another_products_twin_is_refused() -> None:
    twin = Twin("fog", ())
    with pytest.raises(TestloomError, match="one of a fog"):
        make_unit(1, "U-1", twin=twin)
    with pytest.raises(TestloomError, match="one of a fog"):
        PRODUCT.begin(on_stand(twin))
