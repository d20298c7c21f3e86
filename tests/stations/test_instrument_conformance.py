"""What every driver has to do, whatever is behind it; a backend is a subclass with fixtures.

A bench of real instruments passes the same classes: subclass them, give the drivers, and put a known
unit into the socket.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from dut_emulator.products.gnc_module.population import draw_unit
from protocol.errors import Fault, LinkError
from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, OPEN_CIRCUIT_OHM
from protocol.instruments import (
    Multimeter,
    Oscilloscope,
    PowerSupply,
    SocketBoard,
    ThreeAxisTurntable,
)
from stations.drivers.arbitration import Arbitration
from stations.drivers.clock import BranchClock
from stations.drivers.multimeter import ScpiMultimeter
from stations.drivers.oscilloscope import ScpiOscilloscope
from stations.drivers.power_supply import ScpiPowerSupply
from stations.drivers.scpi import ScpiSession
from stations.drivers.socket_bench import SocketBench

from .conftest import SEED, ServedBench

KNOWN_SERIAL = "GNC-00000"


class PowerSupplyConformance:
    """Gives `supply`, channel 1 with nothing or a unit on it."""

    def test_off_is_off(self, supply: PowerSupply):
        supply.switch(1, False)
        assert supply.measure_voltage_v(1) == pytest.approx(0.0, abs=0.05)
        assert supply.measure_current_a(1) == pytest.approx(0.0, abs=0.01)

    def test_on_gives_what_was_set(self, supply: PowerSupply):
        supply.configure(1, 3.0, 0.2)  # below what a unit starts at
        supply.switch(1, True)
        assert supply.measure_voltage_v(1) == pytest.approx(3.0, rel=0.01)
        supply.switch(1, False)

    def test_channels_are_apart(self, supply: PowerSupply):
        supply.configure(1, 3.0, 0.2)
        supply.switch(1, True)
        assert supply.measure_voltage_v(2) == pytest.approx(0.0, abs=0.05)
        supply.switch(1, False)

    def test_what_it_cannot_do_is_an_error_in_its_own_words(self, supply: PowerSupply):
        with pytest.raises(LinkError) as refused:
            supply.configure(1, 1e4, 0.1)
        assert refused.value.fault is Fault.STATION
        # and the next command is answered as if nothing had been
        assert supply.measure_voltage_v(1) == pytest.approx(0.0, abs=0.05)


class MeasuringConformance:
    """Gives `board`, `multimeter`, `oscilloscope`, `clock`, and the known unit, unpowered, in the socket."""

    def test_presence(self, board: SocketBoard):
        assert board.unit_present()

    def test_nothing_routed_is_open(self, board: SocketBoard, multimeter: Multimeter):
        board.open_all()
        assert multimeter.measure_resistance_ohm() >= OPEN_CIRCUIT_OHM

    def test_resistances_are_the_units(self, board: SocketBoard, multimeter: Multimeter):
        truth = draw_unit(SEED, KNOWN_SERIAL).electrical.resistance_ohm
        for kind, pair in (("continuity", CONTINUITY_PAIRS[0]), ("impedance", IMPEDANCE_PAIRS[1])):
            board.route(pair.high, pair.low)
            expected = truth[f"{kind}_{pair.name}"]
            assert multimeter.measure_resistance_ohm() == pytest.approx(expected, rel=0.02, abs=0.05)
        board.open_all()

    def test_measuring_takes_bench_time(self, board: SocketBoard, multimeter: Multimeter, clock: BranchClock):
        board.route("GND_1", "GND_2")
        before_s = clock.now_s()
        multimeter.measure_resistance_ohm()
        assert clock.now_s() - before_s == pytest.approx(0.02, abs=1e-6)
        board.open_all()

    def test_no_signal_has_no_period(self, board: SocketBoard, oscilloscope: Oscilloscope):
        board.route("TIMER_OUT", "GND_1")
        assert oscilloscope.measure_period_s() >= OPEN_CIRCUIT_OHM
        assert oscilloscope.measure_peak_to_peak_v() == pytest.approx(0.0, abs=0.005)
        board.open_all()

    def test_an_unknown_point_is_refused(self, board: SocketBoard):
        with pytest.raises(LinkError, match="NOWHERE"):
            board.route("NOWHERE", "GND_1")


class TurntableConformance:
    """Gives `turntable` and `clock`."""

    def test_it_moves_and_says_where_it_is(self, turntable, clock: BranchClock):
        turntable.home()
        turntable.move_to((10.0, -90.0, 20.0))
        assert turntable.status().state == "READY"
        assert turntable.status().angles_deg == pytest.approx([10.0, -90.0, 20.0], abs=0.01)
        turntable.move_to((0.0, 0.0, 0.0))

    def test_a_turn_is_seen_whole_by_the_encoders(self, turntable: ThreeAxisTurntable, clock: BranchClock):
        turntable.home()
        turntable.move_to((0.0, 0.0, 0.0))
        turntable.start_stream(100)
        began_s = clock.now_s()
        clock.sleep_until(clock.now_s() + 1.0)
        turntable.rotate("outer", 360.0, 4.0, 1.0)
        clock.sleep_until(clock.now_s() + 1.0)
        lasted_s = clock.now_s() - began_s
        samples = turntable.stop_stream()
        assert len(samples) == pytest.approx(100 * lasted_s, abs=2)
        np.testing.assert_allclose(np.diff(samples["time_s"]), 0.01, atol=1e-6)
        turned_rad = samples["rate_rad_s"][:, 2].sum() * 0.01
        assert turned_rad == pytest.approx(2 * np.pi, rel=1e-3)
        norms = np.linalg.norm(samples["specific_force_m_s2"], axis=1)
        assert norms == pytest.approx(9.8013, abs=0.05)

    def test_what_it_cannot_do_is_the_stands_fault(self, turntable: ThreeAxisTurntable):
        turntable.home()
        with pytest.raises(LinkError) as refused:
            turntable.rotate("outer", 36000.0, 1.0, 0.1)
        assert refused.value.fault is Fault.STAND


@pytest.fixture(scope="module")
def emulated_bench(tmp_path_factory) -> Iterator[SocketBench]:
    served = ServedBench(tmp_path_factory.mktemp("conformance"))
    bench = SocketBench(served.description, "1", Arbitration(served.description))
    bench.clock(0).join()
    bench.handler(bench.clock(0)).insert(KNOWN_SERIAL)
    yield bench
    bench.close()
    served.close()


@pytest.fixture(scope="module")
def emulated_stand(tmp_path_factory) -> Iterator[tuple[SocketBench, ServedBench]]:
    served = ServedBench(tmp_path_factory.mktemp("stand"), kind="three_axis_turntable")
    bench = SocketBench(served.description, "1", Arbitration(served.description))
    bench.clock(0).join()
    yield bench, served
    bench.close()
    served.close()


class TestEmulatedPowerSupply(PowerSupplyConformance):
    @pytest.fixture
    def supply(self, emulated_bench: SocketBench) -> PowerSupply:
        return ScpiPowerSupply(ScpiSession(emulated_bench.description.power_supply, "power supply"))


class TestEmulatedMeasuring(MeasuringConformance):
    @pytest.fixture
    def clock(self, emulated_bench: SocketBench) -> BranchClock:
        return emulated_bench.clock(0)

    @pytest.fixture
    def board(self, emulated_bench: SocketBench, clock: BranchClock):
        return emulated_bench.board(clock)

    @pytest.fixture
    def multimeter(self, emulated_bench: SocketBench, clock: BranchClock) -> Multimeter:
        return ScpiMultimeter(ScpiSession(emulated_bench.description.multimeter or "", "multimeter"), clock)

    @pytest.fixture
    def oscilloscope(self, emulated_bench: SocketBench, clock: BranchClock) -> Oscilloscope:
        return ScpiOscilloscope(ScpiSession(emulated_bench.description.oscilloscope or "", "scope"), clock)


class TestEmulatedTurntable(TurntableConformance):
    @pytest.fixture
    def clock(self, emulated_stand) -> BranchClock:
        return emulated_stand[0].clock(0)

    @pytest.fixture
    def turntable(self, emulated_stand, clock: BranchClock):
        return emulated_stand[0].stand(clock)

    def test_an_open_door_is_the_stands_fault(self, turntable, emulated_stand):
        turntable.home()
        emulated_stand[1].inject("stand", "door_open")
        try:
            with pytest.raises(LinkError) as refused:
                turntable.move_to((5.0, 0.0, 0.0))
        finally:
            emulated_stand[1].inject("stand", "none")
        assert refused.value.fault is Fault.STAND
        turntable.stop()


def test_an_instrument_that_is_not_there_is_named(free_port):
    session = ScpiSession(f"TCPIP::127.0.0.1::{free_port}::SOCKET", "power supply")
    with pytest.raises(LinkError) as absent:
        session.query("*IDN?")
    assert absent.value.fault is Fault.STATION
    assert "power supply" in absent.value.where
    session.close()
