"""A SCPI oscilloscope, used for two figures: the period and the peak-to-peak voltage of a signal."""

from stations.drivers.clock import BranchClock
from stations.drivers.scpi import ScpiSession

WINDOW_S = 0.02


class ScpiOscilloscope:
    """Implements `protocol.instruments.Oscilloscope`; lets each window pass on the branch's clock.

    No period in the window reads 9.9E+37 (SCPI-99).
    """

    def __init__(self, session: ScpiSession, clock: BranchClock) -> None:
        self._session = session
        self._clock = clock
        self._function: str | None = None

    def measure_period_s(self) -> float:
        """Period of the signal at the routed test point. Raises LinkError."""
        return self._measure("CONF:PER")

    def measure_peak_to_peak_v(self) -> float:
        """Peak-to-peak voltage at the routed test point. Raises LinkError."""
        return self._measure("CONF:PTP")

    def _measure(self, function: str) -> float:
        if function != self._function:
            self._session.set(function)
            self._function = function
        self._session.set("INIT")
        self._clock.sleep_for(WINDOW_S)
        return self._session.query_number("FETC?")
