# pyright: strict
"""A rate gyro triad on a bench: a supply, a table under it, and three voltages.

The outputs are worked out at 250 Hz, six times the sensors' bandwidth, and kept as their integrals, so that
a voltmeter can have the true mean over its aperture. There is no digital link.

Omitted: the load that a meter is, the outputs' impedance and ripple, and the surge at power-on.
"""

from typing import Any

import numpy as np

from dut_emulator.effects.effect import FloatArray
from dut_emulator.interfaces import LinkOutput, Surroundings
from dut_emulator.lot import LotDraw
from dut_emulator.products.rate_gyro_triad.analogue_gyros import AnalogueGyros, refuse_impossible
from dut_emulator.products.rate_gyro_triad.population import drawn_twin
from dut_emulator.products.stand_unit import StandUnit
from dut_emulator.twin import Twin

OUTPUTS = ("OUT_X", "OUT_Y", "OUT_Z")
PERIOD_S = 4e-3
BLOCK_S = 2.0
"""Outputs are worked out in blocks of at least this time, unless somebody looks."""
MAX_BLOCK_SAMPLES = 16_384
HISTORY_S = 5.0
"""Longer than any voltmeter's aperture."""
SUPPLY_POWER_W = 4.5

_NOISE = 7_001
_INSTANT_TOLERANCE = 1e-6


def make_unit(
    seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> "RateGyroUnit":
    """The unit of this serial number in the lot of this seed, or one with the effects of a twin."""
    return RateGyroUnit(seed, serial, twin or drawn_twin(seed, serial), flash or {})


class RateGyroUnit(StandUnit):
    """See `EmulatedUnit`. What its memory keeps is how often it was powered: each turn-on is another one.

    Raises:
        TestloomError: the twin has an effect that it cannot have.
    """

    turn_on_v = 12.0
    brown_out_v = 11.0

    def __init__(self, seed: int, serial: str, twin: Twin, flash: dict[str, Any]) -> None:
        super().__init__(serial)
        refuse_impossible(twin)
        self._draw = LotDraw(seed, serial)
        self._twin = twin
        self._power_cycles = int(flash.get("power_cycles", 0))
        self._gyros: AnalogueGyros | None = None
        self._power_on_s = 0.0
        self._taken = 0
        self._latest_v = np.zeros(3)
        self._integral_vs = np.zeros((1, 3))
        """∫V dt since power-on at the last `len` instants, the latest of which is that of sample `_taken`."""

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins; until now the outputs saw the old one."""
        self._advance_to(now_s)
        self._sample_to(now_s)
        super().set_supply(voltage_v, now_s)

    def point_voltage_v(self, point: str, now_s: float) -> float:
        """The output now, V; other points and an unpowered unit have 0 V."""
        self._advance_to(now_s)
        self._sample_to(now_s)
        known = point in OUTPUTS and self._gyros is not None
        return float(self._latest_v[OUTPUTS.index(point)]) if known else 0.0

    def mean_voltage_v(self, point: str, begin_s: float, end_s: float) -> float:
        """True mean of an output over an aperture that has just ended, V. Before power-on it was 0 V.

        Raises:
            TestloomError: the aperture began longer ago than the unit remembers.
        """
        self._advance_to(max(end_s, self._now_s))
        self._sample_to(self._now_s)
        if point not in OUTPUTS or self._gyros is None:
            return 0.0
        if begin_s < self._now_s - HISTORY_S:
            raise self._misused("was asked about an aperture of long ago", "read a voltage when it is due.")
        column = OUTPUTS.index(point)
        return (self._integral_at(end_s, column) - self._integral_at(begin_s, column)) / (end_s - begin_s)

    def flash_image(self) -> dict[str, Any]:
        """How often it was powered."""
        return {"power_cycles": self._power_cycles}

    # --- what `StandUnit` asks

    def _power_on(self, surroundings: Surroundings, now_s: float) -> None:
        self._power_cycles += 1
        seed = self._draw.seed_for(_NOISE, self._power_cycles, round(now_s * 1e6))
        self._gyros = AnalogueGyros(self._twin, surroundings.effects, seed, now_s)
        self._power_on_s, self._taken = now_s, 0
        self._latest_v, self._integral_vs = np.zeros(3), np.zeros((1, 3))

    def _power_off(self, now_s: float) -> None:
        del now_s
        self._gyros = None

    def _run_to(self, now_s: float) -> list[LinkOutput]:
        if now_s - self._instant_s(self._taken) >= BLOCK_S:
            self._sample_to(now_s)
        return []

    def _running_current_a(self) -> float:
        return SUPPLY_POWER_W / self._supply_v

    # --- outputs

    def _instant_s(self, number: Any) -> Any:
        return self._power_on_s + number * PERIOD_S

    def _sample_to(self, now_s: float) -> None:
        if self._gyros is None or self._surroundings is None:
            return
        last = int((now_s - self._power_on_s) / PERIOD_S + _INSTANT_TOLERANCE)
        while self._taken < last:
            to = min(last, self._taken + MAX_BLOCK_SAMPLES)
            times_s: FloatArray = self._instant_s(np.arange(self._taken + 1, to + 1, dtype=np.float64))
            acting = self._surroundings.stimulus(times_s)
            volts, _ = self._gyros.sample(times_s, PERIOD_S, acting, self._supply_v)
            before = np.concatenate([self._latest_v[np.newaxis] if self._taken else volts[:1], volts[:-1]])
            # linear between instants; one sum from power-on, which is the same however it is cut
            steps = (before + volts) * (PERIOD_S / 2)
            further = np.cumsum(np.concatenate([self._integral_vs[-1:], steps]), axis=0)
            kept = self._integral_vs[-round(HISTORY_S / PERIOD_S) - 1 :]
            self._integral_vs = np.concatenate([kept, further[1:]])
            self._latest_v, self._taken = volts[-1], to

    def _integral_at(self, time_s: float, column: int) -> float:
        """∫V dt from power-on; past the latest instant the output stays what it was there."""
        rows = self._integral_vs[:, column]
        if len(rows) == 1:
            return 0.0
        first = self._taken + 1 - len(rows)
        place = max((time_s - self._power_on_s) / PERIOD_S - first, 0.0)
        row = min(int(place), len(rows) - 2)
        return float(rows[row] + (place - row) * (rows[row + 1] - rows[row]))
