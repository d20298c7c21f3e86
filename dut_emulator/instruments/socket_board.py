# pyright: strict
"""The board under one socket over SCPI: relays to the shared inputs, the AD switch, the presence contact.

`ROUT:CLOS (@HIGH,LOW)`, `ROUT:OPEN:ALL`, `AD:SWIT SOURCE`, `SENS:PRES?`. Relays settle in 5 ms: a
measurement begun earlier sees an open circuit. While another board has its relays closed, closing is
refused: -200,"inputs in use". The AD switch routes the board's own references to the unit.

Omitted: resistance and thermal voltage of contacts (nulled), crosstalk between routes, relay wear.
"""

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.scpi import Call, ScpiError, ScpiInstrument, expression_items
from dut_emulator.instruments.wiring import Probed, SharedInputs
from protocol.gnc_module import AD_OPEN_INPUT_V, AD_SWITCH_SOURCES, RAIL_NOMINAL_V

RELAY_SETTLING_S = 0.005
REFERENCE_ACCURACY = Accuracy(
    gain_uncertainty=5e-5, zero_uncertainty=0.0, noise_deviation=0.0, resolution=1e-6
)
NOMINAL_OF_SOURCE = {source: RAIL_NOMINAL_V.get(source, AD_OPEN_INPUT_V) for source in AD_SWITCH_SOURCES}
START_SOURCE = "OPEN"


class SocketBoard(ScpiInstrument):
    """The board of one socket, with its name on the shared inputs."""

    def __init__(self, name: str, socket: Probed, inputs: SharedInputs, seed: int, serial: str) -> None:
        super().__init__(f"Testloom,SB1,{serial},1.0")
        self._name = name
        self._socket = socket
        self._inputs = inputs
        self._reference = Reading(REFERENCE_ACCURACY, seed, "reference")
        self._source = START_SOURCE
        self.commands.add("ROUTe:CLOSe", self._close)
        self.commands.add("ROUTe:OPEN:ALL", self._open_all)
        self.commands.add("AD:SWITch", self._switch)
        self.commands.add("AD:SWITch?", self._switched)
        self.commands.add("SENSe:PRESence?", self._presence)

    def reset(self, now_s: float) -> None:
        """All relays open, the AD inputs open."""
        self._inputs.disconnect(self._name)
        self._source = START_SOURCE
        self.apply_ad_source(now_s)

    def apply_ad_source(self, now_s: float) -> None:
        """Put the switched source on the unit; also after a unit was inserted."""
        nominal_v = NOMINAL_OF_SOURCE[self._source]
        self._socket.set_ad_source(self._source, self._reference.of(nominal_v, now_s))

    def _close(self, call: Call) -> None:
        high, low = expression_items(call.exactly(1)[0], 2)
        for point in (high, low):
            if not self._socket.knows_point(point):
                raise ScpiError(-224, point[:40])
        if self._inputs.occupied_by_other(self._name):
            raise ScpiError(-200, "inputs in use")
        self._inputs.connect(self._name, self._socket, high, low, call.now_s + RELAY_SETTLING_S)

    def _open_all(self, call: Call) -> None:
        call.exactly(0)
        self._inputs.disconnect(self._name)

    def _switch(self, call: Call) -> None:
        source = call.exactly(1)[0].upper()
        if source not in NOMINAL_OF_SOURCE:
            raise ScpiError(-224, source[:40])
        self._source = source
        self.apply_ad_source(call.now_s)

    def _switched(self, call: Call) -> str:
        call.exactly(0)
        return self._source

    def _presence(self, call: Call) -> str:
        call.exactly(0)
        return "1" if self._socket.present() else "0"
