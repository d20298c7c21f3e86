"""Recordings by the very twin that the diagnosis holds them against: alarms at 5 % are 5 %.

Units have what `believed` can say, on stands without errors; units that the lot made defective are left out.
"""

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.effect import name_of
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.order import LABORATORY
from dut_emulator.recording.recorder import recorded
from dut_emulator.stands.catalogue import recording_stand
from dut_emulator.twin import Twin
from gap_diagnosis.diagnosis import diagnose
from tests.dut_emulator_recordings.test_believed_model import SAYABLE

LARGEST_CHANCE = 0.01
"""Of so many alarms or more, were their rate 6.5 %."""


def unit(product_name: str, profile: str, seed: int) -> Twin:
    product = product_named(product_name)
    own = [one for one in product.twin(seed, f"U-{seed:04d}").effects if one.word in SAYABLE]
    stand = recording_stand(product.profiles[profile].stand, 1, LABORATORY)
    sensors = {effect.sensor for effect in own} | {"temperature"}
    still = [effect_named(name_of(one), one.sensor) for one in stand.effects if one.sensor in sensors]
    return Twin(product_name, (*still, *own))


def alarms(product: str, profile: str, units: int) -> int:
    good = [s for s in range(1, 2 * units) if not product_named(product).defects(s, f"U-{s:04d}")][:units]
    count = 0
    for seed in good:
        twin = unit(product, profile, seed)
        recording = recorded(product, profile, twin=twin, seed=seed, serial=f"U-{seed:04d}")
        count += diagnose([recording]).document["verdict"] != "no_gap"
    return count


def chance_of(count: int, units: int, rate: float = 0.065) -> float:
    """Binomial: this many or more."""
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, units + 1)))])
    k = np.arange(count, units + 1)
    ways = log_factorial[units] - log_factorial[k] - log_factorial[units - k]
    return float(np.exp(ways + k * np.log(rate) + (units - k) * np.log1p(-rate)).sum())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("product", "profile", "units"), [("fog", "static", 60), ("mems_ahrs", "static", 20)]
)
def test_a_twin_held_against_itself_alarms_by_chance_alone(product: str, profile: str, units: int) -> None:
    assert chance_of(alarms(product, profile, units), units) > LARGEST_CHANCE
