# pyright: strict
"""An oscilloscope as a counter and a peak-to-peak meter over SCPI, window 20 ms.

`CONF:PER`, `CONF:PTP`, `INIT`, `FETC?`. The input is the high point against the low one; a signal
without a period, or one longer than the window, is answered with 9.9E+37.

Omitted: traces, trigger settings, bandwidth, probe attenuation and the noise of the front end in a
period (jitter is one number).
"""

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.acquisition import AcquiringInstrument
from dut_emulator.instruments.scpi import Call
from dut_emulator.instruments.wiring import SharedInputs

WINDOW_S = 0.02
PERIOD_ACCURACY = Accuracy(
    gain_uncertainty=1e-6, zero_uncertainty=0.0, noise_deviation=2e-9, resolution=1e-10
)
RIPPLE_ACCURACY = Accuracy(
    gain_uncertainty=5e-3, zero_uncertainty=1e-4, noise_deviation=2e-4, resolution=5e-5
)


class Oscilloscope(AcquiringInstrument):
    """An oscilloscope on the shared inputs of a bench."""

    def __init__(self, inputs: SharedInputs, seed: int, serial: str) -> None:
        super().__init__(f"Testloom,OSC1,{serial},1.0")
        self._inputs = inputs
        self._function = "PER"
        self._period = Reading(PERIOD_ACCURACY, seed, "period")
        self._ripple = Reading(RIPPLE_ACCURACY, seed, "ripple")
        self.commands.add("CONFigure:PERiod", self.configure(lambda: self._choose("PER")))
        self.commands.add("CONFigure:PTPeak", self.configure(lambda: self._choose("PTP")))
        self.commands.add("CONFigure?", self._configuration)

    def window_s(self) -> float:
        """The record's length."""
        return WINDOW_S

    def evaluate(self, begin_s: float, end_s: float) -> float:
        """Period in s, or peak-to-peak in V."""
        connected = self._inputs.connected(begin_s)
        if self._function == "PTP":
            true_v = connected[0].ripple_v(connected[1], end_s) if connected else 0.0
            return max(self._ripple.of(true_v, end_s, self._inputs.label), 0.0)
        period_s = connected[0].period_s(connected[1], end_s) if connected else None
        if period_s is None or period_s > WINDOW_S:
            return float("inf")
        return self._period.of(period_s, end_s, self._inputs.label)

    def _choose(self, function: str) -> None:
        self._function = function

    def _configuration(self, call: Call) -> str:
        call.exactly(0)
        return f'"{self._function}"'
