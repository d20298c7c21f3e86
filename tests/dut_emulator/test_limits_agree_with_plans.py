"""The emulator and the plans share no code: their limits are held against each other here."""

import math

import pytest

from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.product_limits import HEALTHY_MARGIN_U, PRODUCT_LIMITS
from dut_emulator.products.gnc_module.unit_truth import Category
from protocol.measurements import MeasurementSpecification
from protocol.units_of_measure import factor_to_si, quantity_of
from stations.sequencing.step_registry import bundled_plans

PLANS = ("functional", "imu_calibration", "imu_calibration_paper")
UNITS = [draw_unit(seed, f"GM-{number:04d}") for seed in (7, 8) for number in range(1, 401)]


def declared() -> list[tuple[str, MeasurementSpecification, str]]:
    """Every measurement of the plans that one of the emulator's limits is about: plan, it, limit's name."""
    found = []
    for name, plan in bundled_plans().items():
        for step in plan.steps():
            for measurement in step.measurements:
                limit = "timer_period_error" if "timer_period" in measurement.name else measurement.name
                if limit in PRODUCT_LIMITS:
                    found.append((name, measurement, limit))
    return found


DECLARED = declared()


def test_every_measurand_is_measured_by_some_plan() -> None:
    assert set(PLANS) <= bundled_plans().keys()
    assert {limit for _, _, limit in DECLARED} == PRODUCT_LIMITS.keys()


@pytest.mark.parametrize(("plan", "measurement", "name"), DECLARED)
def test_limits_are_the_same(plan: str, measurement: MeasurementSpecification, name: str) -> None:
    limit, factor = PRODUCT_LIMITS[name], factor_to_si(measurement.unit)
    assert quantity_of(measurement.unit) == quantity_of(limit.unit)
    for emulators, plans in ((limit.low, measurement.low), (limit.high, measurement.high)):
        if emulators is not None:
            assert plans is not None
            assert plans * factor == pytest.approx(emulators, rel=1e-12)
    # how near 'near_limit' is; the paper's longer rests may be better, nobody may be worse
    assert measurement.standard_uncertainty is not None
    assert measurement.standard_uncertainty * factor <= limit.standard_uncertainty * (1 + 1e-9)


def test_plans_hold_healthy_units_inside_and_defects_outside() -> None:
    for unit in UNITS:
        outside = set()
        for _, measurement, name in DECLARED:
            if name not in unit.measurands:
                continue
            value = unit.measurands[name] / factor_to_si(measurement.unit)
            u = measurement.standard_uncertainty
            assert u is not None
            low = -math.inf if measurement.low is None else measurement.low
            high = math.inf if measurement.high is None else measurement.high
            if not low <= value <= high:
                outside.add(name)
            if unit.category is Category.HEALTHY:
                # the plans' low limits of noise find dead axes: 6 u would be below zero there
                margin = high - value if "noise" in name else min(value - low, high - value)
                assert margin >= HEALTHY_MARGIN_U * u, (unit.serial, name)
        parametric = {name for name in unit.affected if name in unit.measurands}
        if not unit.category.is_defective:
            assert not outside
        elif unit.defect not in ("dead_gyro_axis", "ad_channel_off"):
            assert outside == parametric
