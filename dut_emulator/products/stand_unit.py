# pyright: strict
"""A unit that is wired through a stand or a plain socket: supply and links, no test points of a board."""

import math
from typing import Any

from dut_emulator.interfaces import LinkOutput, Surroundings
from protocol.errors import Fault, TestloomError


class StandUnit:
    """The base of such units: power, time and what leaves. See `EmulatedUnit`.

    A product says what happens when it is powered (`_power_on`), when power goes (`_power_off`), while time
    passes (`_run_to`) and what it draws (`_running_current_a`).
    """

    turn_on_v = 4.5
    brown_out_v = 4.2

    def __init__(self, serial: str) -> None:
        self._serial = serial
        self._surroundings: Surroundings | None = None
        self._supply_v = 0.0
        self._powered = False
        self._now_s = -math.inf
        self._left: list[LinkOutput] = []

    def insert(self, surroundings: Surroundings, now_s: float) -> None:
        """The unit is put into a socket, unpowered."""
        self.set_supply(0.0, now_s)
        self._surroundings = surroundings

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins; between brown-out and turn-on voltage the state stays."""
        self._advance_to(now_s)
        self._supply_v = voltage_v
        if not self._powered and voltage_v >= self.turn_on_v:
            if self._surroundings is None:
                raise self._misused("was powered before it was put into a socket", "call insert() first.")
            self._powered = True
            self._power_on(self._surroundings, now_s)
        elif self._powered and voltage_v < self.brown_out_v:
            self._powered = False
            self._power_off(now_s)

    def receive(self, link: str, data: bytes, now_s: float, can_id: int | None = None) -> None:
        """Bytes arrive; an unpowered unit hears nothing."""
        self._advance_to(now_s)
        if self._powered:
            self._received(link, data, now_s, can_id)

    def next_event_s(self) -> float | None:
        """When the unit will next do something by itself."""
        if self._left:
            return self._left[0].time_s
        return self._next_event_s() if self._powered else None

    def advance(self, to_s: float) -> list[LinkOutput]:
        """Everything that has left the unit since the last call, in order of time."""
        self._advance_to(to_s)
        left, self._left = self._left, []
        return left

    def supply_current_a(self, now_s: float) -> float:
        """True current drawn at the present supply voltage."""
        self._advance_to(now_s)
        return self._running_current_a() if self._powered else 0.0

    def resistance_ohm(self, high: str, low: str) -> float:
        """Open: there are no test points."""
        del high, low
        return math.inf

    def point_voltage_v(self, point: str, now_s: float) -> float:
        """No voltage, unless the product has analogue outputs."""
        del point
        self._advance_to(now_s)
        return 0.0

    def point_ripple_v(self, point: str, now_s: float) -> float:
        """No ripple."""
        del point, now_s
        return 0.0

    def point_period_s(self, point: str, now_s: float) -> float | None:
        """No square wave."""
        del point, now_s
        return None

    def set_ad_source(self, source: str, voltage_v: float) -> None:
        """There is no AD switch."""

    def flash_image(self) -> dict[str, Any]:
        """What the unit keeps without power, JSON-able."""
        return {}

    # --- what a product says

    def _power_on(self, surroundings: Surroundings, now_s: float) -> None:
        raise NotImplementedError

    def _power_off(self, now_s: float) -> None:
        raise NotImplementedError

    def _run_to(self, now_s: float) -> list[LinkOutput]:
        """What leaves in (last call, now_s], while powered."""
        raise NotImplementedError

    def _received(self, link: str, data: bytes, now_s: float, can_id: int | None) -> None:
        """Bytes arrive while powered; a unit that takes no commands ignores them."""

    def _next_event_s(self) -> float | None:
        return None

    def _running_current_a(self) -> float:
        raise NotImplementedError

    def _advance_to(self, now_s: float) -> None:
        if now_s < self._now_s:
            raise self._misused(
                f"was asked about {now_s} s after {self._now_s} s", "keep the bench's clock from going back."
            )
        self._now_s = now_s
        if self._powered:
            self._left += self._run_to(now_s)

    def _misused(self, what: str, remedy: str) -> TestloomError:
        return TestloomError(
            f"A unit {what}.", where=f"emulated unit {self._serial}", fault=Fault.TESTLOOM, remedy=remedy
        )
