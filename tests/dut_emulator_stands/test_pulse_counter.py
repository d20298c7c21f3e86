"""The pulse counter: gates in closed form on a made-up source, then unit, rig and counter as on a bench."""

import math

import numpy as np
import pytest

from calibration.algorithms.sinusoidal_overload import HalfCycles, KnownAccelerometer, joint_solve
from dut_emulator.effects.catalogue import effect_named
from dut_emulator.instruments.pulse_counter import PulseCounter
from dut_emulator.instruments.scpi import Session
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.products.product import UnitOnStand
from dut_emulator.products.pulse_imu import make_unit
from dut_emulator.products.pulse_imu.product import COLUMNS, PRODUCT
from dut_emulator.stands.sinusoidal_overload_rig import LiveOverloadRig, OverloadPort, SinusoidalOverloadRig
from dut_emulator.stands.sinusoidal_overload_rig.live_rig import PAYLOAD_KG
from dut_emulator.twin import Twin
from protocol.bench_description import Site
from protocol.errors import TestloomError

G = 9.80665
SITE = Site(latitude_deg=40.0, gravity_m_s2=G)
K1 = 10_000.0 / G


class Steady:
    """Channel k counts (k + 1) thousand pulses a second; edges every 0.1 s until 0.85 s."""

    on = True

    def pulse_totals(self, now_s: float):
        rate = 1000.0 * (np.arange(12) + 1.0)
        return (np.floor(rate * now_s + 1e-6) * self.on).astype(np.int64).reshape(6, 2)

    def next_edge_s(self, after_s: float) -> float | None:
        edge = (math.floor(after_s / 0.1 + 1e-9) + 1) * 0.1
        return edge if edge < 0.85 else None


def counter_on(source=None) -> tuple[PulseCounter, Session, Steady]:
    steady = source or Steady()
    return PulseCounter(steady, steady, "PC-1"), Session(), steady


def read(counter: PulseCounter, session: Session, line: str, now_s: float) -> list[float]:
    answer = counter.execute(line, session, now_s)
    assert answer is not None, session.errors
    return [float(figure) for figure in answer.split(",")]


def test_a_gate_by_time() -> None:
    counter, session, _ = counter_on()
    assert counter.execute("CONF:GATE:TIME 0.25;CONF:GATE?", session, 0.0) == "TIME,0.25"
    counter.execute("INIT", session, 0.05)
    assert counter.next_event_s() == pytest.approx(0.3)
    assert counter.execute("FETC?", session, 0.2) is None
    assert session.next_error() == '-230,"Data corrupt or stale;the gate is open"'
    assert read(counter, session, "FETC?", 0.3) == [250.0 * (k + 1) for k in range(12)]
    assert read(counter, session, "FETC:TIM?", 0.4) == [0.05, 0.3]
    assert counter.execute("STAT:QUES:COND?", session, 0.4) == "0"
    assert counter.next_event_s() is None


def test_a_gate_by_the_trigger_line() -> None:
    counter, session, _ = counter_on()
    counter.execute("CONF:GATE:TRIG 3;INIT", session, 0.12)
    for edge_s in (0.2, 0.3, 0.4, 0.5):
        assert counter.next_event_s() == pytest.approx(edge_s)
        counter.advance(edge_s)
    assert counter.next_event_s() is None
    halves = np.reshape(read(counter, session, "FETC:HALV?", 0.6), (3, 12))
    np.testing.assert_array_equal(halves, np.tile(100.0 * (np.arange(12) + 1), (3, 1)))
    assert read(counter, session, "FETC?", 0.6) == [300.0 * (k + 1) for k in range(12)]
    assert counter.execute("STAT:QUES:COND?", session, 0.6) == "0"


def test_what_goes_wrong_is_said() -> None:
    counter, session, steady = counter_on()
    assert counter.execute("FETC?", session, 0.0) is None
    assert "nothing counted" in session.next_error()
    counter.execute("CONF:GATE:TRIG 1.5", session, 0.0)
    assert session.next_error().startswith("-224")
    counter.execute("CONF:GATE:TRIG 2;INIT;INIT", session, 0.0)
    assert session.next_error() == '-221,"Settings conflict;the gate is open"'
    counter.advance(0.25)  # passed by 0.1 and 0.2
    steady.on = False
    counter.advance(0.3)
    assert counter.execute("STAT:QUES:COND?", session, 0.3) == "6"  # late, and off in between
    np.testing.assert_allclose(read(counter, session, "FETC:TIM?", 0.3), [0.1, 0.3])
    counter.execute("INIT", session, 0.9)
    assert "no edge to come" in session.next_error()
    alone = PulseCounter(steady, None, "PC-2")
    alone.execute("CONF:GATE:TRIG 1;INIT", session, 0.0)
    assert "no edge to come" in session.next_error()


def test_overflow_is_marked() -> None:
    counter, session, _ = counter_on()
    counter.execute("CONF:GATE:TIME 1500;INIT", session, 0.0)
    counts = read(counter, session, "FETC?", 1500.0)
    assert counts[10] == 16_500_000
    assert counts[11] == 18_000_000 - 2**24
    assert counter.execute("STAT:QUES:COND?", session, 1500.0) == "1"


class Bench:
    """Rig, unit and counter in lock-step: time stops wherever the counter asks for it."""

    def __init__(self, twin: Twin | None = None) -> None:
        self.rig = LiveOverloadRig(SinusoidalOverloadRig(SITE))
        self.port = OverloadPort(self.rig, "Testloom,SOR,R-1,1.0")
        self.unit = make_unit(1, "U-0001", twin=twin)
        self.unit.insert(self.rig, 0.0)
        self.unit.set_supply(12.0, 0.0)
        self.counter = PulseCounter(self.unit, self.port, "PC-1")
        self.session = Session()
        self.now_s = 0.0

    def pass_time(self, to_s: float) -> None:
        while (event_s := self.counter.next_event_s()) is not None and event_s <= to_s:
            self._stop(event_s)
        self._stop(to_s)

    def ask(self, line: str) -> str:
        return self.counter.execute(line, self.session, self.now_s) or ""

    def _stop(self, at_s: float) -> None:
        self.unit.advance(at_s)
        self.counter.advance(at_s)
        self.now_s = at_s


PAPER = Twin(
    "pulse_imu",
    (
        effect_named("acc.odd_quadratic_nonlinearity", odd_square=(1e-5 / G,) * 3),
        effect_named("acc.scale_factor_asymmetry", asymmetry=(1e-4,) * 3),
    ),
)


def test_counts_between_zero_marks_give_the_coefficients() -> None:
    """Twenty cycles at 12 g, counted live; T, V, S from the rig's own HALF?."""
    bench, cycles = Bench(PAPER), 20
    start_s = float(bench.port.command("RUN 12", 0.0).removeprefix("OK "))
    bench.pass_time(start_s + 0.1)
    bench.ask(f"CONF:GATE:TRIG {2 * cycles};INIT")
    bench.pass_time(start_s + 6.0)
    assert bench.ask("STAT:QUES:COND?") == "0"
    counts = np.reshape([int(n) for n in bench.ask("FETC:HALV?").split(",")], (2 * cycles, 6, 2))
    net = counts[:, 0, 0] - counts[:, 0, 1]
    halves = {}
    for _ in range(2):
        force, *figures = bench.port.command("HALF?", bench.now_s).split(",")
        halves[force] = [float(figure) for figure in figures]
        bench.pass_time(bench.now_s + halves[force][0])
    first = "1" if net[0] > 0 else "-1"
    assert (np.sign(net) == np.tile([int(first), -int(first)], cycles)).all()
    positive, negative = net[net > 0].sum(), net[net < 0].sum()
    motion = HalfCycles(*(cycles * np.array([[halves["1"][part], halves["-1"][part]]]) for part in range(3)))
    known = KnownAccelerometer(K1, 0.0, 0.0, 0.0, 0.0)
    found = joint_solve(motion, np.array([[positive, negative]], dtype=float), known)[0]
    one_pulse = 1.0 / (2 * cycles * 8568)
    assert found[0] == pytest.approx(1e-4, abs=2 * one_pulse)
    assert found[1] * G == pytest.approx(1e-5, abs=4e-6)
    assert counts[:, 1:3].sum(axis=(0, 2)).max() == counts[:, 1].sum()  # y is up: 1 g; z feels nothing


def test_live_and_recorded_counts_are_one_physics() -> None:
    """A second of a live run against a recorded one, from the same phase: a few pulses apart."""
    bench = Bench(PAPER)
    start_s = float(bench.port.command("RUN 10", 0.0).removeprefix("OK "))
    bench.pass_time(start_s)
    bench.ask("CONF:GATE:TRIG 8;INIT")
    bench.pass_time(start_s + 3.0)
    begin_s, end_s = (float(edge) for edge in bench.ask("FETC:TIM?").split(","))
    live = np.array([int(n) for n in bench.ask("FETC?").split(",")])
    rig = SinusoidalOverloadRig(SITE)
    run = rig.run("overload", profile_named("overload").values({"payload_kg": PAYLOAD_KG}))
    streams = PRODUCT.begin(UnitOnStand(PAPER, (), run, 1000.0, np.random.SeedSequence(1), "U-0001"))
    columns = streams.advance(run.duration_s)["dut"]
    marks_s = run.trigger_times_s
    assert end_s - begin_s == pytest.approx(marks_s[8] - marks_s[0], abs=2e-9)
    totals = [np.interp([marks_s[0], marks_s[8]], columns["t"], np.cumsum(columns[name])) for name in COLUMNS]
    np.testing.assert_allclose(live, [end - begin for begin, end in totals], atol=3)


def test_totals_do_not_depend_on_when_they_are_asked_for() -> None:
    """With noise: many questions in between, or none."""
    asked, left_alone = Bench(), Bench()
    for bench in (asked, left_alone):
        bench.port.command("RUN 3", 0.0)
    totals = [asked.unit.pulse_totals(float(now_s)) for now_s in np.linspace(0.0, 1.9999, 211)]
    assert (np.diff(totals, axis=0) >= 0).all(), "no counter runs backwards"
    np.testing.assert_allclose(asked.unit.pulse_totals(2.0), left_alone.unit.pulse_totals(2.0), atol=1)
    assert asked.unit.pulse_totals(2.0)[1, 0] == pytest.approx(2.0 * 10_000, rel=2e-3)


def test_power_and_identity_of_a_unit() -> None:
    bench = Bench()
    bench.pass_time(1.0)
    assert bench.unit.supply_current_a(1.0) == pytest.approx(1.0)
    first = bench.unit.pulse_totals(1.0)
    bench.unit.set_supply(0.0, 1.0)
    assert not bench.unit.pulse_totals(1.5).any()
    assert bench.unit.flash_image() == {"power_cycles": 1}
    bench.unit.set_supply(12.0, 2.0)
    second = bench.unit.pulse_totals(3.0)
    assert (first != second).any(), "another turn-on has another bias and other noise"
    assert np.abs(first - second).max() < 10
    with pytest.raises(TestloomError, match=r"cannot have the effect .mag\.bias."):
        make_unit(1, "U-0001", twin=Twin("", (effect_named("mag.bias", bias_si=(1e-6, 0.0, 0.0)),)))
    with pytest.raises(TestloomError, match="one of a fog"):
        make_unit(1, "U-0001", twin=Twin("fog"))
