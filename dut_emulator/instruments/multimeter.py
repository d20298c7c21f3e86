# pyright: strict
"""A 6½-digit multimeter over SCPI: resistance and DC voltage, an aperture in power-line cycles.

`CONF:RES`, `CONF:VOLT:DC`, `SENS:NPLC n`, `INIT`, `FETC?`. Two-wire, with the leads nulled. A socket
under power has no resistance to measure: overload. Above its range it answers 9.9E+37.

Omitted: ranges and their separate accuracies, lead resistance, input bias current, settling into the
capacitance of a unit, and averaging over a signal that changes within the aperture (its end counts).
"""

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.acquisition import AcquiringInstrument
from dut_emulator.instruments.scpi import Call, formatted, number
from dut_emulator.instruments.wiring import SharedInputs

POWER_LINE_CYCLE_S = 0.02
MIN_CYCLES, MAX_CYCLES = 0.02, 100.0
MAX_RESISTANCE_OHM = 1e9
MAX_VOLTAGE_V = 100.0
HIGH_RESISTANCE_OHM = 10e6
"""Above it leakage of the cables counts, and the accuracy is that of an insulation range."""

RESISTANCE_ACCURACY = Accuracy(
    gain_uncertainty=5e-5,
    zero_uncertainty=5e-4,
    noise_deviation=3e-4,
    resolution=1e-4,
    relative_noise_deviation=1e-5,
)
INSULATION_ACCURACY = Accuracy(
    gain_uncertainty=4e-3,
    zero_uncertainty=1e3,
    noise_deviation=1e3,
    resolution=1e2,
    relative_noise_deviation=1e-3,
)
VOLTAGE_ACCURACY = Accuracy(
    gain_uncertainty=2e-5, zero_uncertainty=2e-5, noise_deviation=1e-5, resolution=1e-6
)


class Multimeter(AcquiringInstrument):
    """A multimeter on the shared inputs of a bench."""

    def __init__(self, inputs: SharedInputs, seed: int, serial: str) -> None:
        super().__init__(f"Testloom,DMM6,{serial},1.0")
        self._inputs = inputs
        self._function = "VOLT"
        self._cycles = 1.0
        self._resistance = Reading(RESISTANCE_ACCURACY, seed, "res")
        self._insulation = Reading(INSULATION_ACCURACY, seed, "insulation")
        self._voltage = Reading(VOLTAGE_ACCURACY, seed, "volt")
        self.commands.add("CONFigure:RESistance", self.configure(lambda: self._choose("RES")))
        self.commands.add("CONFigure:VOLTage[:DC]", self.configure(lambda: self._choose("VOLT")))
        self.commands.add("CONFigure?", self._configuration)
        self.commands.add("[SENSe:]NPLC", self._set_cycles)
        self.commands.add("[SENSe:]NPLC?", self._get_cycles)

    def reset(self, now_s: float) -> None:  # noqa: ARG002 - see the base class
        """DC volts, one power-line cycle, nothing acquired."""
        self._function, self._cycles = "VOLT", 1.0
        self.discard()

    def window_s(self) -> float:
        """The aperture."""
        return self._cycles * POWER_LINE_CYCLE_S

    def evaluate(self, begin_s: float, end_s: float) -> float:
        """Ω or V between the connected points."""
        connected = self._inputs.connected(begin_s)
        label = self._inputs.label
        if connected is None:
            return float("inf") if self._function == "RES" else self._voltage.of(0.0, end_s, label)
        socket, high, low = connected
        if self._function == "RES":
            return self._read_resistance(socket.resistance_ohm(high, low), end_s, label)
        true = socket.voltage_v(high, low, end_s)
        return (
            float("inf") if abs(true) > MAX_VOLTAGE_V else self._voltage.of(true, end_s, label, self._cycles)
        )

    def _read_resistance(self, true_ohm: float, now_s: float, label: str) -> float:
        if true_ohm > MAX_RESISTANCE_OHM:
            return float("inf")
        reading = self._insulation if true_ohm > HIGH_RESISTANCE_OHM else self._resistance
        return reading.of(true_ohm, now_s, label, self._cycles)

    def _choose(self, function: str) -> None:
        self._function = function

    def _configuration(self, call: Call) -> str:
        call.exactly(0)
        return f'"{self._function}"'

    def _set_cycles(self, call: Call) -> None:
        self._cycles = number(call.exactly(1)[0], MIN_CYCLES, MAX_CYCLES)
        self.discard()

    def _get_cycles(self, call: Call) -> str:
        call.exactly(0)
        return formatted(self._cycles)
