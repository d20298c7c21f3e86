"""What every SCPI instrument of a bench has in common, and its own commands: pure, without a port."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.multimeter import Multimeter
from dut_emulator.instruments.oscilloscope import Oscilloscope
from dut_emulator.instruments.power_supply import PowerSupply
from dut_emulator.instruments.scpi import MAX_QUEUED_ERRORS, ScpiInstrument, Session
from dut_emulator.instruments.socket_board import SocketBoard
from dut_emulator.instruments.wiring import SharedInputs

NO_ERROR = '0,"No error"'


class Resistor:
    """A load and test points as simple as can be: R between any two points, 1 V on 5V_1, a square wave."""

    def __init__(self, resistance_ohm: float = 10.0) -> None:
        self.resistance = resistance_ohm
        self.supply_v = 0.0
        self.ad: tuple[str, float] | None = None

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        self.supply_v = voltage_v

    def supply_current_a(self, now_s: float) -> float:
        return self.supply_v / self.resistance

    def resistance_ohm(self, high: str, low: str) -> float:
        return self.resistance

    def voltage_v(self, high: str, low: str, now_s: float) -> float:
        return 1.0 if high == "5V_1" else 0.0

    def ripple_v(self, point: str, now_s: float) -> float:
        return 0.02

    def period_s(self, point: str, now_s: float) -> float | None:
        return 1e-3 if point == "TIMER_OUT" else None

    def knows_point(self, point: str) -> bool:
        return point in ("5V_1", "GND_1", "TIMER_OUT")

    def present(self) -> bool:
        return True

    def set_ad_source(self, source: str, voltage_v: float) -> None:
        self.ad = (source, voltage_v)


def supply() -> PowerSupply:
    return PowerSupply([Resistor(), Resistor()], 1, "S")


def instruments() -> list[ScpiInstrument]:
    inputs = SharedInputs()
    return [
        supply(),
        Multimeter(inputs, 1, "S"),
        Oscilloscope(inputs, 1, "S"),
        SocketBoard("1", Resistor(), inputs, 1, "S"),
    ]


class Desk:
    """One session with one instrument."""

    def __init__(self, instrument: ScpiInstrument) -> None:
        self.instrument, self.session, self.now_s = instrument, Session(), 0.0

    def __call__(self, line: str) -> str | None:
        return self.instrument.execute(line, self.session, self.now_s)

    def error(self) -> str:
        answer = self("SYST:ERR?")
        assert answer is not None
        return answer


@pytest.mark.parametrize("instrument", instruments(), ids=lambda one: type(one).__name__)
def test_what_all_instruments_have_in_common(instrument: ScpiInstrument) -> None:
    desk = Desk(instrument)
    identification = desk("*IDN?")
    assert identification is not None
    assert len(identification.split(",")) == 4
    assert desk("*rst;*opc?") == "1"
    assert desk("system:error?") == desk(":SYST:ERR:NEXT?") == NO_ERROR
    assert desk("FROB:NICATE 3") is None
    assert desk.error().startswith('-113,"Undefined header')
    assert desk("*IDN? 3") is None
    assert desk.error().startswith("-108,")
    assert desk("1;2") is None
    assert desk.error().startswith("-102,")
    assert desk("*IDN?\x07") is None
    assert desk.error().startswith("-101,")
    desk("FROB")
    assert int(desk("*ESR?") or 0) & 0x20  # a command error
    assert desk("*ESR?") == "0"
    assert int(desk("*STB?") or 0) & 0x04
    desk("*CLS")
    assert desk.error() == NO_ERROR


def test_the_error_queue_is_bounded_and_ends_in_an_overflow() -> None:
    desk = Desk(supply())
    for _ in range(MAX_QUEUED_ERRORS + 5):
        desk("FROB")
    entries = [desk.error() for _ in range(MAX_QUEUED_ERRORS)]
    assert entries[-1] == '-350,"Queue overflow"'
    assert desk.error() == NO_ERROR


def test_sessions_do_not_read_each_others_errors() -> None:
    instrument = supply()
    one, other = Desk(instrument), Desk(instrument)
    one("FROB")
    assert other.error() == NO_ERROR
    assert one.error().startswith("-113")


@given(st.text(max_size=60))
def test_no_line_whatever_breaks_an_instrument(line: str) -> None:
    for instrument in instruments():
        desk = Desk(instrument)
        desk(line)
        assert desk("*OPC?") == "1"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("VOLT 5", -109),
        ("VOLT 5,(@1),3", -108),
        ("VOLT five,(@1)", -104),
        ("VOLT 21,(@1)", -222),
        ("VOLT -1,(@1)", -222),
        ("VOLT 5,(@3)", -222),
        ("VOLT 5,(@)", -171),
        ("VOLT 5,1", -171),
        ("OUTP MAYBE,(@1)", -141),
        ("CURR 99,(@1)", -222),
    ],
)
def test_a_supply_refuses_under_the_standard_number(line: str, code: int) -> None:
    desk = Desk(supply())
    assert desk(line) is None
    assert desk.error().startswith(f"{code},")


def test_a_supply_drives_measures_and_limits() -> None:
    load = Resistor(10.0)
    desk = Desk(PowerSupply([load], 7, "S"))
    for line in ("SOURce:VOLTage 5,(@1)", "curr 1,(@1)", "OUTP:STAT ON,(@1)"):
        desk(line)
    assert desk.error() == NO_ERROR
    assert desk("OUTP? (@1);:STAT:QUES:COND? (@1)") == "1;0"
    assert float(desk("MEAS:VOLT? (@1)") or 0) == pytest.approx(load.supply_v, abs=5 * 1.3e-3)
    assert float(desk("MEAS:CURR? (@1)") or 0) == pytest.approx(0.5, abs=5e-4)
    load.resistance = 2.0  # now it would draw 2.5 A
    assert float(desk("MEAS:CURR? (@1)") or 0) == pytest.approx(1.0, abs=1e-3)
    assert load.supply_v == pytest.approx(2.0, rel=1e-3)
    assert desk("STAT:QUES:COND? (@1)") == "1"
    desk("OUTP OFF,(@1)")
    assert load.supply_v == 0.0
    assert float(desk("MEAS:CURR? (@1)") or 1) == pytest.approx(0.0, abs=5e-4)


def test_a_multimeter_takes_its_aperture_and_sees_what_is_routed() -> None:
    inputs = SharedInputs()
    meter = Desk(Multimeter(inputs, 3, "M"))
    board = Desk(SocketBoard("1", Resistor(1234.5), inputs, 3, "B"))
    assert meter("FETC?") is None
    assert meter.error().startswith('-230,"Data corrupt or stale;nothing')
    meter("CONF:RES")
    board("ROUT:CLOS (@5V_1,GND_1)")
    board.now_s = meter.now_s = 0.005
    meter("SENS:NPLC 2;:INIT")
    meter.now_s = 0.044
    assert meter("FETC?") is None
    assert meter.error().startswith('-230,"Data corrupt or stale;acquisition is running')
    meter.now_s = 0.045
    assert float(meter("FETC?") or 0) == pytest.approx(1234.5, rel=3e-4)
    meter("INIT;INIT")
    assert meter.error().startswith("-221")
    board("ROUT:OPEN:ALL")
    meter("ABOR;:INIT")
    meter.now_s += 1.0
    assert float(meter("FETC?") or 0) == 9.9e37
    assert board.error() == NO_ERROR


def test_relays_bounce_for_five_milliseconds() -> None:
    inputs = SharedInputs()
    meter = Desk(Multimeter(inputs, 3, "M"))
    board = Desk(SocketBoard("1", Resistor(), inputs, 3, "B"))
    board("ROUT:CLOS (@5V_1,GND_1)")
    meter.now_s = 0.004
    meter("CONF:RES;:INIT")
    meter.now_s = 1.0
    assert float(meter("FETC?") or 0) == 9.9e37


def test_a_forgotten_arbitration_shows_itself() -> None:
    inputs = SharedInputs()
    one, two = (Desk(SocketBoard(name, Resistor(), inputs, 1, name)) for name in "12")
    one("ROUT:CLOS (@5V_1,GND_1)")
    two("ROUT:CLOS (@5V_1,GND_1)")
    assert two.error() == '-200,"inputs in use"'
    two("ROUT:OPEN:ALL")  # opens its own only
    two("ROUT:CLOS (@5V_1,GND_1)")
    assert two.error() == '-200,"inputs in use"'
    one("ROUT:OPEN:ALL")
    two("ROUT:CLOS (@5V_1,GND_1)")
    assert two.error() == NO_ERROR
    one("ROUT:CLOS (@NOWHERE,GND_1)")
    assert one.error().startswith("-224")


def test_an_oscilloscope_sees_periods_and_ripple() -> None:
    inputs = SharedInputs()
    scope = Desk(Oscilloscope(inputs, 5, "O"))
    board = Desk(SocketBoard("1", Resistor(), inputs, 5, "B"))

    def measure(function: str, point: str) -> float:
        board.now_s = scope.now_s
        board(f"ROUT:CLOS (@{point},GND_1)")
        scope.now_s += 0.01
        scope(f"CONF:{function};:INIT")
        scope.now_s += 0.02
        return float(scope("FETC?") or math.nan)

    assert measure("PER", "TIMER_OUT") == pytest.approx(1e-3, rel=2e-5)
    assert measure("PER", "5V_1") == 9.9e37
    assert measure("PTP", "5V_1") == pytest.approx(0.02, abs=1.5e-3)


def test_the_board_switches_its_references_to_the_unit() -> None:
    unit = Resistor()
    board = Desk(SocketBoard("1", unit, SharedInputs(), 1, "B"))
    board("AD:SWIT 3V3")
    assert unit.ad is not None
    assert unit.ad[0] == "3V3"
    assert unit.ad[1] == pytest.approx(3.3, rel=3e-4)
    board("AD:SWIT 7V")
    assert board.error().startswith("-224")
    assert board("AD:SWIT?;:SENS:PRES?") == "3V3;1"


def test_the_stated_uncertainty_is_that_of_many_instruments() -> None:
    """Over 400 instruments the errors scatter as stated (4 standard errors of a standard deviation)."""
    accuracy = Accuracy(1e-3, 2e-3, 5e-4, 1e-6)
    errors = [Reading(accuracy, seed, "volt").of(10.0, 0.0) - 10.0 for seed in range(400)]
    expected = math.hypot(10.0 * 1e-3, 2e-3, 5e-4)
    spread = math.sqrt(sum(error**2 for error in errors) / len(errors))
    assert spread == pytest.approx(expected, rel=4 / math.sqrt(2 * len(errors)))
    assert Reading(accuracy, 1, "volt").of(10.0, 0.0) == Reading(accuracy, 1, "volt").of(10.0, 0.0)
    assert Reading(accuracy, 1, "volt").of(10.0, 0.0) != Reading(accuracy, 1, "volt").of(10.0, 1.0)
