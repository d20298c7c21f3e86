"""Lots: variance components as stated, defects at their rates, and the same unit whoever draws it."""

import math
from importlib import import_module

import numpy as np
import pytest

from dut_emulator.effects.effect import name_of
from dut_emulator.lot import UNITS_PER_WAFER, LotDraw, Spread
from dut_emulator.lot_defects import defects_of
from dut_emulator.products.catalogue import product_named

DEFECTIVE = {
    "fog": "population",
    "rate_gyro_triad": "population",
    "pulse_imu": "population",
    "mems_ahrs": "unit_effects",
}
WAFERS, LOTS = 20, 40


def test_lot_wafer_and_unit_each_have_their_part_of_the_variance() -> None:
    """A nested analysis of variance over lots of many wafers."""
    spread = Spread(unit=1.0, wafer=2.0, lot=3.0)
    values = np.array(
        [
            [
                [
                    LotDraw(lot, f"U-{wafer * UNITS_PER_WAFER + unit}").normal("p", 5.0, spread)
                    for unit in range(6)
                ]
                for wafer in range(WAFERS)
            ]
            for lot in range(LOTS)
        ]
    )
    # a normal variable cut at three deviations has 0.9866 of the variance
    cut = 0.98658
    unit = values.var(axis=2, ddof=1).mean()
    wafer = values.mean(axis=2).var(axis=1, ddof=1).mean() - unit / 6
    lot = values.mean(axis=(1, 2)).var(ddof=1) - (wafer + unit / 6) / WAFERS
    assert unit == pytest.approx(cut * 1.0, rel=4 * math.sqrt(2 / (LOTS * WAFERS * 5)))
    assert wafer == pytest.approx(cut * 4.0, rel=4 * math.sqrt(2 / (LOTS * (WAFERS - 1))))
    assert lot == pytest.approx(cut * 9.0, rel=4 * math.sqrt(2 / (LOTS - 1)))
    assert values.mean() == pytest.approx(5.0, abs=4 * 3.2 / math.sqrt(LOTS))


@pytest.mark.parametrize("product", DEFECTIVE)
def test_defects_come_at_their_rates_and_show_in_the_twin(product: str) -> None:
    defects = import_module(f"dut_emulator.products.{product}.{DEFECTIVE[product]}").DEFECTS
    draws = [LotDraw(1, f"U-{number:05d}") for number in range(1200)]
    for defect in defects:
        hit = [draw for draw in draws if defect in defects_of(draw, defects)]
        expected = len(draws) * defect.rate
        assert abs(len(hit) - expected) < 4.5 * math.sqrt(expected)
        alone = next(draw for draw in hit if defects_of(draw, defects) == (defect,))
        twin = product_named(product).twin(1, alone.serial)
        effect = next(e for e in twin.effects if (name_of(e), e.sensor) == (defect.effect, defect.sensor))
        now = np.array(getattr(effect, defect.field))
        # healthy units of the same lot never come near it
        healthy = [draw for draw in draws[:400] if not defects_of(draw, defects)]
        others = np.array(
            [
                getattr(
                    next(
                        e
                        for e in product_named(product).twin(1, draw.serial).effects
                        if (name_of(e), e.sensor) == (defect.effect, defect.sensor)
                    ),
                    defect.field,
                )
                for draw in healthy[:60]
            ]
        )
        centre = np.median(others, axis=0)
        assert np.abs(now - centre).max() > 1.2 * np.abs(others - centre).max()


def test_the_same_unit_whoever_draws_it_and_in_whatever_order() -> None:
    product = product_named("mems_ahrs")
    forward = [product.twin(3, f"U-{n}") for n in range(5)]
    backward = [product.twin(3, f"U-{n}") for n in reversed(range(5))]
    assert forward == backward[::-1]
    assert forward[0] != product.twin(4, "U-0")
