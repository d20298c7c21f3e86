"""A lot: determined by seed and serial, graded by the limits, and at the stated rates."""

import dataclasses
import json
import math
import random

import numpy as np
import pytest

from dut_emulator.products.gnc_module.defects import DEFECTS, NEAR_LIMIT_MEASURANDS
from dut_emulator.products.gnc_module.population import (
    GROSS_SHARE,
    MARGINAL_SHARE,
    NEAR_LIMIT_SHARE,
    draw_unit,
    truth_table,
)
from dut_emulator.products.gnc_module.product_limits import HEALTHY_MARGIN_U, PRODUCT_LIMITS, ProductLimit
from dut_emulator.products.gnc_module.unit_truth import Category, UnitTruth
from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2, is_known_unit

SERIALS = [f"GM-{number:04d}" for number in range(1, 1501)]

pytestmark = pytest.mark.xdist_group("population")  # drawn once for all


@pytest.fixture(scope="module")
def lot() -> list[UnitTruth]:
    return [draw_unit(7, serial) for serial in SERIALS]


def of(lot: list[UnitTruth], *categories: Category) -> list[UnitTruth]:
    return [unit for unit in lot if unit.category in categories]


def test_a_unit_is_its_seed_and_serial_in_whatever_order(lot: list[UnitTruth]) -> None:
    shuffled = list(enumerate(SERIALS[:60]))
    random.Random(1).shuffle(shuffled)
    for index, serial in shuffled:
        assert draw_unit(7, serial) == lot[index]
    assert draw_unit(8, SERIALS[0]).measurands != lot[0].measurands
    assert len({unit.measurands["supply_current"] for unit in lot}) > 1400


def test_categories_come_at_their_rates(lot: list[UnitTruth]) -> None:
    shares = {
        Category.GROSS: GROSS_SHARE,
        Category.MARGINAL: MARGINAL_SHARE,
        Category.NEAR_LIMIT: NEAR_LIMIT_SHARE,
        Category.HEALTHY: 1 - GROSS_SHARE - MARGINAL_SHARE - NEAR_LIMIT_SHARE,
    }
    for category, share in shares.items():
        count = len(of(lot, category))
        assert abs(count - share * len(lot)) < 4 * math.sqrt(len(lot) * share * (1 - share))
    assert 0.20 <= GROSS_SHARE + MARGINAL_SHARE <= 0.25


def test_every_kind_of_defect_occurs(lot: list[UnitTruth]) -> None:
    assert {unit.defect for unit in of(lot, Category.GROSS)} == {kind.name for kind in DEFECTS}
    marginal = {unit.defect for unit in of(lot, Category.MARGINAL)}
    assert marginal == {kind.name for kind in DEFECTS if kind.can_be_marginal}
    assert not any(unit.defect for unit in of(lot, Category.HEALTHY, Category.NEAR_LIMIT))


def acc_norm_error(unit: UnitTruth) -> float:
    """What a level accelerometer triad reads beyond g, from the finished truth."""
    scale = np.diag(1 + np.array(unit.acc.scale_factor_error))
    matrix = scale @ (np.eye(3) + np.array(unit.acc.misalignment_rad))
    reading = matrix @ [0, 0, STANDARD_GRAVITY_M_S2] + np.array(unit.acc.bias_si)
    return float(np.linalg.norm(reading)) - STANDARD_GRAVITY_M_S2


def test_healthy_units_are_well_inside_every_limit(lot: list[UnitTruth]) -> None:
    for unit in of(lot, Category.HEALTHY):
        values = {**unit.measurands, "acc_norm_error": acc_norm_error(unit)}
        for name, value in values.items():
            assert PRODUCT_LIMITS[name].margin_u(value) >= HEALTHY_MARGIN_U, (unit.serial, name, value)
        assert not unit.digital.wrong_addresses
        assert unit.gnss.acquires
        assert unit.gnss.satellites_used >= 9


def test_near_limit_units_have_one_measurand_by_a_hair_inside(lot: list[UnitTruth]) -> None:
    for unit in of(lot, Category.NEAR_LIMIT):
        (name,) = unit.affected
        assert 1.0 - 1e-9 <= PRODUCT_LIMITS[name].margin_u(unit.measurands[name]) <= 4.0 + 1e-9
        for other, value in unit.measurands.items():
            assert other == name or PRODUCT_LIMITS[other].margin_u(value) >= HEALTHY_MARGIN_U


def test_marginal_defects_lie_half_a_width_beyond(lot: list[UnitTruth]) -> None:
    for unit in of(lot, Category.MARGINAL):
        (name,) = unit.affected
        limit, value = PRODUCT_LIMITS[name], unit.magnitude
        assert value == unit.measurands[name]
        # the definition again, from the plain limits: a one-sided limit is as wide as it is large
        low, high = limit.low, limit.high
        width = high - low if low is not None and high is not None else (high or low)
        beyond = value - high if high is not None and value > high else low - value
        assert beyond / width == pytest.approx(0.5)


def test_gross_defects_are_far_out_or_no_matter_of_degree(lot: list[UnitTruth]) -> None:
    for unit in of(lot, Category.GROSS):
        name = unit.affected[0]
        if name in unit.measurands and unit.defect not in ("dead_gyro_axis", "ad_channel_off"):
            assert PRODUCT_LIMITS[name].margin_u(unit.measurands[name]) < -20, (unit.defect, name)


def test_truth_reaches_the_physics(lot: list[UnitTruth]) -> None:
    for unit in lot[:200]:
        values = unit.measurands
        assert 1 / (1 + unit.crystal_error) - 1 == pytest.approx(values["timer_period_error"], abs=1e-12)
        assert math.hypot(*unit.gnss.position_error_m) == pytest.approx(values["gnss_position_error"])
        if unit.defect != "dead_gyro_axis" and unit.affected[:1] != ("continuity_layer_link_imu",):
            assert unit.gyro.scale_factor_error[1] == values["gyro_scale_factor_error_y"]
            assert unit.gyro.misalignment_rad[0][2] == values["gyro_coupling_xz"]
            assert unit.acc.noise_density_si[2] * math.sqrt(200) == pytest.approx(values["acc_noise_z"])


def test_an_open_layer_link_takes_its_layer_along(lot: list[UnitTruth]) -> None:
    opened = {unit.affected[0]: unit for unit in of(lot, Category.GROSS) if unit.defect == "open_pin"}
    assert not opened["continuity_layer_link_gnss"].gnss.acquires
    assert opened["continuity_layer_link_imu"].gyro.scale_factor_error == (-1.0, -1.0, -1.0)
    shorted = [unit for unit in of(lot, Category.GROSS) if unit.defect == "shorted_pin"]
    assert {unit.affected[0].split("_")[1] for unit in shorted} >= {"can", "rs422"}
    for unit in shorted:
        assert unit.digital.can_silent == unit.affected[0].startswith("insulation_can")
        assert unit.digital.rs422_silent == unit.affected[0].startswith("insulation_rs422")


def test_the_table_of_truth_is_plain_json(lot: list[UnitTruth]) -> None:
    rows = truth_table(7, SERIALS[:300])
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    assert [row["serial"] for row in rows] == SERIALS[:300]
    for row, unit in zip(rows, lot, strict=False):
        assert row["defective"] == (unit.category in (Category.GROSS, Category.MARGINAL))


def test_limits_are_well_formed_and_cover_every_pair() -> None:
    names = {f"continuity_{p.name}" for p in CONTINUITY_PAIRS} | {
        f"insulation_{p.name}" for p in INSULATION_PAIRS
    }
    assert names | {f"impedance_{p.name}" for p in IMPEDANCE_PAIRS} <= PRODUCT_LIMITS.keys()
    for limit in PRODUCT_LIMITS.values():
        assert is_known_unit(limit.unit)
        assert limit.low is not None or limit.high is not None
        assert limit.width > 12 * limit.standard_uncertainty
    for name, side in NEAR_LIMIT_MEASURANDS:
        limit = PRODUCT_LIMITS[name]
        assert (limit.low if side < 0 else limit.high) is not None


def test_limit_arithmetic_by_hand() -> None:
    both = ProductLimit("a", "V", 4.75, 5.25, 0.01, "")
    assert both.beyond(0.5, -1) == 4.5
    assert both.beyond(3.0, 1) == 6.75
    assert both.inside(2.0, -1) == pytest.approx(4.77)
    assert both.margin_u(5.2) == pytest.approx(5.0)
    assert both.margin_u(5.3) == pytest.approx(-5.0)
    low_only = dataclasses.replace(both, high=None)
    assert low_only.width == 4.75
    assert low_only.margin_u(100.0) == pytest.approx(9525.0)
