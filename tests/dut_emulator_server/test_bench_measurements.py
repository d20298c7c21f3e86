"""Measurements over the bench's real ports, held against the truth that no station sees."""

import pytest

from dut_emulator.products.gnc_module.population import draw_unit
from protocol.gnc_module import (
    BOOT_DURATION_S,
    CONTINUITY_PAIRS,
    IMPEDANCE_PAIRS,
    INSULATION_PAIRS,
    SELF_TEST_LAYOUT,
    FrameType,
    ReplyStatus,
    SelfTest,
)

SEED = 5
NO_ERROR = '0,"No error"'
OVERLOAD = 9.9e37


@pytest.fixture
def bench(start_bench):
    return start_bench(seed=SEED)


class Desk:
    """A participant at one socket with its board and the shared instruments."""

    def __init__(self, bench, socket: int = 1) -> None:
        self.participant = bench.participant(f"socket {socket}")
        resources = bench.description.sockets[socket - 1]
        self.board = bench.instrument(resources.board)
        self.supply = bench.instrument(bench.description.power_supply)
        self.meter = bench.instrument(bench.description.multimeter)
        self.scope = bench.instrument(bench.description.oscilloscope)
        self.link = self.participant.open(resources.unit_link)
        self.socket = str(socket)

    def insert(self, serial: str) -> None:
        assert self.participant.ask(op="insert", socket=self.socket, serial=serial)["ok"]

    def power(self) -> None:
        for command in ("VOLT 5.0", "CURR 0.8", "OUTP ON"):
            assert self.supply.command(f"{command},(@{self.socket})") == NO_ERROR
        self.participant.wait(self.participant.now_s + BOOT_DURATION_S + 0.01)

    def measure(self, instrument, function: str, high: str, low: str = "GND_1") -> float:
        assert self.board.command(f"ROUT:CLOS (@{high},{low})") == NO_ERROR
        self.participant.wait(self.participant.now_s + 0.005)
        assert instrument.command(f"CONF:{function}") == NO_ERROR
        assert instrument.command("INIT") == NO_ERROR
        self.participant.wait(self.participant.now_s + 0.02)
        value = float(instrument.query("FETC?"))
        assert self.board.command("ROUT:OPEN:ALL") == NO_ERROR
        return value


def healthy_serial() -> str:
    """A serial number whose unit is well inside all limits."""
    return next(
        serial
        for serial in (f"GNC-{number:04}" for number in range(100))
        if draw_unit(SEED, serial).category == "healthy"
    )


def test_resistances_are_the_units(bench) -> None:
    desk = Desk(bench)
    serial = healthy_serial()
    truth = draw_unit(SEED, serial).electrical.resistance_ohm
    assert desk.measure(desk.meter, "RES", "5V_1", "5V_2") == OVERLOAD  # an empty socket
    assert desk.board.query("SENS:PRES?") == "0"
    desk.insert(serial)
    assert desk.board.query("SENS:PRES?") == "1"
    for kind, pairs, relative in (
        ("continuity", CONTINUITY_PAIRS, 0.02),
        ("insulation", INSULATION_PAIRS, 0.02),
        ("impedance", IMPEDANCE_PAIRS, 1e-3),
    ):
        for pair in pairs:
            reading = desk.measure(desk.meter, "RES", pair.high, pair.low)
            assert reading == pytest.approx(truth[f"{kind}_{pair.name}"], rel=relative), pair
    desk.power()
    assert desk.measure(desk.meter, "RES", "5V_1", "5V_2") == OVERLOAD  # nothing to measure under power


def test_rails_current_ripple_and_timer_are_the_units(bench) -> None:
    desk = Desk(bench)
    serial = healthy_serial()
    unit = draw_unit(SEED, serial)
    desk.insert(serial)
    desk.power()
    truth = unit.electrical
    assert float(desk.supply.query("MEAS:VOLT? (@1)")) == pytest.approx(5.0, abs=0.01)
    assert float(desk.supply.query("MEAS:CURR? (@1)")) == pytest.approx(truth.current_running_a, abs=2e-3)
    assert float(desk.supply.query("MEAS:CURR? (@2)")) == pytest.approx(0.0, abs=1e-3)
    assert desk.measure(desk.meter, "VOLT:DC", "3V3_1") == pytest.approx(truth.rail_3v3_v, abs=1e-3)
    assert desk.measure(desk.meter, "VOLT:DC", "1V2_1") == pytest.approx(truth.rail_1v2_v, abs=1e-3)
    assert desk.measure(desk.scope, "PTP", "5V_1") == pytest.approx(truth.ripple_v, abs=2e-3)
    assert desk.measure(desk.scope, "PER", "TIMER_OUT") == OVERLOAD  # no timer test is running
    reply = desk.participant.exchange(
        desk.link, FrameType.SELF_TEST, SELF_TEST_LAYOUT.pack(SelfTest.TIMER, 2000)
    )
    assert reply.payload[0] == ReplyStatus.ACCEPTED
    expected_s = 2000e-6 / (1 + unit.crystal_error)
    assert desk.measure(desk.scope, "PER", "TIMER_OUT") == pytest.approx(expected_s, rel=1e-5)


def test_two_sockets_have_to_take_turns_at_the_shared_inputs(bench) -> None:
    one, two = Desk(bench, 1), Desk(bench, 2)
    assert one.board.command("ROUT:CLOS (@5V_1,GND_1)") == NO_ERROR
    assert two.board.command("ROUT:CLOS (@5V_1,GND_1)") == '-200,"inputs in use"'
    assert one.participant.ask(op="suspend")["ok"]  # as a branch that waits for the other one's turn
    assert one.board.command("ROUT:OPEN:ALL") == NO_ERROR
    assert two.measure(two.meter, "RES", "5V_1", "GND_1") == OVERLOAD
    two.participant.close()
    assert one.participant.ask(op="resume")["ok"]
    assert one.measure(one.meter, "RES", "5V_1", "GND_1") == OVERLOAD


def test_an_aperture_ends_at_its_own_moment_while_another_waits_longer(bench) -> None:
    """The window's end is a moment of its own on the way of a long wait; the reading is of then."""
    desk = Desk(bench)
    desk.insert(healthy_serial())
    desk.power()
    assert desk.board.command("ROUT:CLOS (@5V_1,GND_1)") == NO_ERROR
    desk.participant.wait(desk.participant.now_s + 0.01)
    assert desk.meter.command("CONF:VOLT:DC;:INIT") == NO_ERROR
    desk.participant.wait(desk.participant.now_s + 5.0)
    assert desk.supply.command("OUTP OFF,(@1)") == NO_ERROR
    assert float(desk.meter.query("FETC?")) == pytest.approx(5.0, abs=0.05)
    assert float(desk.supply.query("MEAS:VOLT? (@1)")) == pytest.approx(0.0, abs=2e-3)


def test_a_unit_that_draws_too_much_brings_the_channel_to_its_limit(bench) -> None:
    desk = Desk(bench)
    desk.insert(healthy_serial())
    assert desk.supply.command("VOLT 5.0,(@1)") == NO_ERROR
    assert desk.supply.command("CURR 0.1,(@1)") == NO_ERROR
    assert desk.supply.command("OUTP ON,(@1)") == NO_ERROR
    assert desk.supply.query("STAT:QUES:COND? (@1)") == "1"
    assert float(desk.supply.query("MEAS:CURR? (@1)")) == pytest.approx(0.1, abs=1e-3)
    assert float(desk.supply.query("MEAS:VOLT? (@1)")) < 4.0
    refusal = desk.participant.ask(op="insert", socket="1", serial="GNC-0099")
    assert "holds unit" in refusal["what"]
    assert desk.participant.ask(op="remove", socket="1")["ok"]
    assert "under power" in desk.participant.ask(op="insert", socket="1", serial="GNC-0099")["what"]
