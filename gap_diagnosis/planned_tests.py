# pyright: strict
"""The tests that a product can undergo, each with what would act on the unit.

A profile as it is by default, and some in a second form: a long rest, a tumble while rotating, a fast ramp of
temperature, positions and rates at two temperatures where the stand has a chamber. A form that the stand
refuses is left out.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.run import Run
from dut_emulator.products.catalogue import product_named
from dut_emulator.products.product import Mounting
from dut_emulator.recording.order import LABORATORY
from dut_emulator.stands.catalogue import recording_stand
from protocol.errors import TestloomError

MAX_ROWS, MAX_FINE_ROWS = 8_192, 200_000
FINE_PERIOD_S = 1e-3
"""Between two samples a real input is not linear: lags and delays of milliseconds are told at this step."""
_STAND_SEED = 1
_MILD: Mapping[str, float] = {"cold_c": 0.0, "hot_c": 50.0, "ramp_c_per_min": 5.0}
_TWO_TEMPERATURES: Mapping[str, float] = {"levels": 2.0, "rate_deg_s": 100.0}
_AS_BY_DEFAULT: Mapping[str, float] = {}

SECOND_FORMS: Mapping[str, tuple[Mapping[str, float], ...]] = {
    "static": ({"duration_s": 1800.0},),
    "tumble": ({"spin_deg_s": 100.0},),
    "temperature_ramp": ({**_MILD, "soak_s": 120.0},),
    "thermal_positions": (_TWO_TEMPERATURES, {**_TWO_TEMPERATURES, **_MILD, "soak_s": 600.0}),
}
"""Profile → values beside the default ones; what is not named is at its default."""


@dataclass(frozen=True)
class PlannedTest:
    """One test of a product.

    Attributes:
        profile, stand: as in the catalogues.
        values: of the profile's parameters that are not at their defaults.
        sample_period_s: of the unit in this test.
        run: what the stand does.
    """

    profile: str
    stand: str
    values: tuple[tuple[str, float], ...]
    sample_period_s: float
    run: Run

    @property
    def duration_s(self) -> float:
        """Of the run, without mounting."""
        return self.run.duration_s

    @property
    def minutes(self) -> float:
        """Of the run."""
        return self.duration_s / 60.0

    def stimulus(self, *, fine: bool) -> Stimulus:
        """What acts, (n,) uniform: few rows, or so many that milliseconds are seen where the run is short."""
        step_s = min(FINE_PERIOD_S, self.sample_period_s) if fine else self.sample_period_s
        most = MAX_FINE_ROWS if fine and self.duration_s <= MAX_FINE_ROWS * FINE_PERIOD_S else MAX_ROWS
        period_s = max(step_s, self.duration_s / most)
        times_s: FloatArray = np.arange(max(int(self.duration_s / period_s), 1), dtype=np.float64) * period_s
        return dataclasses.replace(self.run.stimulus(times_s), sample_period_s=period_s)


@lru_cache(maxsize=8)
def planned_tests(product: str) -> tuple[PlannedTest, ...]:
    """All tests of a product.

    Raises:
        TestloomError: there is no such product.
    """
    return tuple(_tests(product))


def _tests(product: str) -> Iterator[PlannedTest]:
    for profile, mounting in product_named(product).profiles.items():
        for values in (_AS_BY_DEFAULT, *SECOND_FORMS.get(profile, ())):
            try:
                yield _planned(profile, mounting, values)
            except TestloomError:  # beyond what this stand can do
                continue


def _planned(profile: str, mounting: Mounting, values: Mapping[str, float]) -> PlannedTest:
    stand = recording_stand(mounting.stand, _STAND_SEED, LABORATORY)
    run = stand.run(profile, profile_named(profile).values(values))
    return PlannedTest(profile, mounting.stand, tuple(values.items()), 1.0 / mounting.rate_hz, run)
