"""A SCPI multimeter."""

from stations.drivers.clock import BranchClock
from stations.drivers.scpi import ScpiSession

POWER_LINE_CYCLE_S = 0.02


class ScpiMultimeter:
    """Implements `protocol.instruments.Multimeter`; lets each aperture pass on the branch's clock.

    An overload or an open circuit reads 9.9E+37 (SCPI-99).
    """

    def __init__(self, session: ScpiSession, clock: BranchClock, power_line_cycles: float = 1.0) -> None:
        self._session = session
        self._clock = clock
        self._cycles = power_line_cycles
        self._function: str | None = None

    def measure_resistance_ohm(self) -> float:
        """Resistance between the routed test points. Raises LinkError."""
        return self._measure("CONF:RES")

    def measure_voltage_v(self) -> float:
        """Direct voltage between the routed test points. Raises LinkError."""
        return self._measure("CONF:VOLT:DC")

    def _measure(self, function: str) -> float:
        if function != self._function:
            self._session.set(function)
            self._session.set(f"SENS:NPLC {self._cycles:g}")
            self._function = function
        self._session.set("INIT")
        self._clock.sleep_for(self._cycles * POWER_LINE_CYCLE_S)
        return self._session.query_number("FETC?")
