"""The overload rig of paper 5: crank, flywheel and power in closed form; its runs; its port.

Vectors as in tests/dut_emulator_products; everything else is worked out here from the geometry.
"""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from calibration.algorithms.overload_motion import half_cycles_from_grating
from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.effect import EffectState
from dut_emulator.effects.stand import Wobble
from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.crank import Crank, CrankTurn, Flywheel
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.sinusoidal_overload_rig import OverloadPort
from dut_emulator.stands.sinusoidal_overload_rig.drive import Drive, drive_figures
from dut_emulator.stands.sinusoidal_overload_rig.rig import RigErrors, SinusoidalOverloadRig
from protocol.bench_description import Site
from protocol.errors import TestloomError

ORACLE = Path(__file__).parents[1] / "dut_emulator_products" / "vectors_sinusoidal_overload.json"
BY_G = {case["A0_g"]: case for case in json.loads(ORACLE.read_text(encoding="utf-8"))["cases"]}
G = 9.80665
SITE = Site(latitude_deg=40.0, gravity_m_s2=9.8)
R = 0.15


def run_of(rig: SinusoidalOverloadRig, **given):
    return rig.run("overload", profile_named("overload").values(given))


@given(st.floats(0.0, 0.9), st.floats(-7.0, 7.0))
@settings(max_examples=100, deadline=None)
def test_the_crank_is_the_textbooks(ratio: float, angle: float) -> None:
    crank = Crank(R, ratio)

    def x(theta: float) -> float:
        if ratio < 1e-6:
            return R * math.cos(theta)
        rod = R / ratio
        return R * math.cos(theta) + math.sqrt(rod**2 - (R * math.sin(theta)) ** 2) - rod

    at, h = np.array([angle]), 1e-3
    assert crank.position(at)[0] == pytest.approx(x(angle), abs=1e-7)
    slope = (8 * (x(angle + h) - x(angle - h)) - (x(angle + 2 * h) - x(angle - 2 * h))) / (12 * h)
    assert crank.slope(at)[0] == pytest.approx(slope, abs=1e-6)
    bend = (crank.slope(at + h)[0] - crank.slope(at - h)[0]) / (2 * h)
    assert crank.curvature(at)[0] == pytest.approx(bend, abs=1e-5)


@pytest.mark.parametrize(("ratio", "counter"), [(0.0, 0.0), (0.0, 1.4), (0.2, 1.0), (0.3, 0.0)])
def test_the_flywheel_turns_as_the_energy_says(ratio: float, counter: float) -> None:
    """θ(t) against the quadrature of dt = √(I / 2E) dθ to 1e-12; the energy stays; v̇ is the acceleration."""
    flywheel = Flywheel(Crank(R, ratio), 5.0, 100.0, counter * 100.0)
    turn, omega = CrankTurn(flywheel), 20.0

    def root(theta: float) -> float:
        def slope(at: float) -> float:
            s, c = math.sin(at), math.cos(at)
            return -R * s * (1 + ratio * c / math.sqrt(1 - (ratio * s) ** 2))

        return math.sqrt(5.0 + 100.0 * slope(theta) ** 2 + counter * 100.0 * slope(theta + math.pi / 2) ** 2)

    whole = quad(root, 0, 2 * math.pi, epsabs=1e-13, epsrel=1e-13, limit=200)[0]
    times_s = np.array([0.0, 0.03, 0.1, 0.2, 0.29])
    state = turn.at(omega * times_s, np.full(5, omega), np.zeros(5))
    spent = [quad(root, 0, angle, epsabs=1e-13, epsrel=1e-13, limit=200)[0] for angle in state.angle_rad]
    np.testing.assert_allclose(np.array(spent) / whole * 2 * math.pi, omega * times_s, atol=1e-12)
    energy = 0.5 * state.speed_rad_s**2 * np.array([root(angle) ** 2 for angle in state.angle_rad])
    np.testing.assert_allclose(energy, flywheel.kinetic_energy_j(omega), rtol=1e-12)
    steps = [turn.at(omega * (times_s + k), np.full(5, omega), np.zeros(5)) for k in (-1e-5, 1e-5)]
    np.testing.assert_allclose(
        (steps[1].velocity_m_s - steps[0].velocity_m_s) / 2e-5, state.acceleration_m_s2, rtol=1e-6, atol=1e-5
    )


def test_balanced_slides_on_a_yoke_leave_no_ripple() -> None:
    """Paper 5, fig. 2: sin² + cos². With one slide alone the speed goes as √(I_most / I_least)."""
    assert CrankTurn(Flywheel(Crank(R), 20.0, 105.0, 105.0)).speed_ripple < 1e-14
    alone = CrankTurn(Flywheel(Crank(R), 20.0, 105.0, 0.0))
    angles = alone.at(np.linspace(0, 2 * np.pi, 10_001), np.ones(10_001), np.zeros(10_001)).speed_rad_s
    assert angles.max() / angles.min() == pytest.approx(math.sqrt((20 + 105 * R**2) / 20), rel=1e-7)
    assert alone.speed_ripple == pytest.approx(np.ptp(angles), rel=1e-6)


@pytest.mark.parametrize("overload_g", [1.0, 12.0])
def test_what_the_motor_gives(overload_g: float) -> None:
    """A yoke in closed form: swing m r² ω³ / 2, its mean over π / 2, rolling, drag."""
    drive, mass = Drive(), 105.0
    omega = math.sqrt(overload_g * G / R)
    found = drive_figures(drive, drive.flywheel(Crank(R), 45.0, 1.0), omega, G)
    swing = mass * R**2 * omega**3 / 2
    friction = (
        0.003 * mass * G * R * omega * 2 / math.pi + 20 * (R * omega) ** 2 / 2 + 0.03 * swing * 2 / math.pi
    )
    assert found.slide_swing_w == pytest.approx(swing, rel=1e-5)
    assert found.flywheel_swing_w < 1e-9 * swing
    assert found.mean_power_w == pytest.approx(2 * friction, rel=1e-4)
    assert found.kinetic_energy_j == pytest.approx(0.5 * (20 + mass * R**2) * omega**2, rel=1e-12)
    slowest = omega / 6.0
    assert found.start_up_s == pytest.approx(
        max(2 * found.kinetic_energy_j / (2000.0 - found.mean_power_w), slowest), rel=1e-9
    )
    assert found.mean_power_w < found.peak_power_w < 0.2 * swing + 100.0


def test_without_a_counter_slide_the_flywheel_takes_it_all() -> None:
    drive = Drive()
    found = drive_figures(drive, drive.flywheel(Crank(R), 45.0, 0.0), 25.0, G)
    assert found.flywheel_swing_w == pytest.approx(found.slide_swing_w)
    assert found.speed_ripple > 0.02


@pytest.mark.parametrize("overload_g", [1.0, 5.0, 10.0, 12.0])
def test_what_a_run_gives(overload_g: float) -> None:
    case, rig = BY_G[overload_g], SinusoidalOverloadRig(SITE)
    run = run_of(rig, overload_g=overload_g, cycles=3)
    assert run.speed_rad_s == pytest.approx(case["omega"], abs=1e-6)
    marks_s = run.trigger_times_s
    assert len(marks_s) == 7
    np.testing.assert_allclose(marks_s, case["T_s"] * (0.25 + 0.5 * np.arange(7)), atol=1e-8)
    assert run.duration_s == pytest.approx(3.75 * case["T_s"], abs=1e-8)
    velocity = run.slide(marks_s).velocity_m_s / G
    np.testing.assert_allclose(np.diff(velocity)[:2], [case["dV_gs"], -case["dV_gs"]], atol=1e-8)
    zero, centre = run.events()
    np.testing.assert_allclose(zero.columns["t"], marks_s, atol=5.1e-8)
    np.testing.assert_array_equal(zero.columns["position"], 0.0)
    assert zero.columns["direction"].tolist() == [-1, 1, -1, 1, -1, 1, -1]
    np.testing.assert_allclose(centre.columns["t"], case["T_s"] * 0.5 * np.arange(8), atol=5.1e-8)
    np.testing.assert_allclose(np.abs(centre.columns["position"]), R, atol=5e-8)


@pytest.mark.parametrize(("axis", "up"), [(1, 1), (2, 0), (3, 0)])
def test_how_the_unit_sits(axis: int, up: int) -> None:
    """Over whole cycles the stroke's force has no mean; gravity is on the vertical axis."""
    run = run_of(SinusoidalOverloadRig(SITE), axis=axis, cycles=2)
    times_s = run.period_s * (np.arange(2000) + 0.5) / 1000
    stimulus = run.stimulus(times_s)
    mean = np.zeros(3)
    mean[up] = SITE.gravity_m_s2
    np.testing.assert_allclose(stimulus.channel("specific_force_m_s2").mean(axis=0), mean, atol=1e-9)
    assert stimulus.channel("specific_force_m_s2")[:, axis - 1].max() == pytest.approx(10 * G, rel=1e-5)
    earth = 7.292115e-5
    assert stimulus.channel("rate_rad_s")[0, up] == pytest.approx(earth * math.sin(math.radians(40)))
    assert np.linalg.norm(stimulus.channel("rate_rad_s")[0]) == pytest.approx(earth)
    # (Ω × g) · stroke is the same in any right-handed axes: Ω cos φ g
    across = np.cross(stimulus.channel("rate_rad_s")[0], mean)[axis - 1]
    assert across == pytest.approx(earth * math.cos(math.radians(40)) * SITE.gravity_m_s2)
    rows = np.array(stimulus.channel("specific_force_m_s2")[:1])
    np.testing.assert_array_equal(run.stimulus(times_s[:1]).channel("specific_force_m_s2"), rows)


def test_the_catalogue_speaks_of_the_same_crank() -> None:
    """A yoke with 'stand.crank_geometry' is a slider-crank but for terms of λ³, some 2 %."""
    even = SinusoidalOverloadRig(SITE, drive=Drive(inertia_kg_m2=1e12))
    yoke, slider = (run_of(even, crank=crank, cycles=1) for crank in (0, 1))
    times_s = np.arange(0.0, 0.25, 1e-5)
    stimulus = dataclasses.replace(yoke.stimulus(times_s), sample_period_s=1e-5)
    effect = effect_named("stand.crank_geometry", "acc", ratio=0.2, radius_m=R)
    rng, state = np.random.default_rng(1), EffectState()
    bent = effect.apply(stimulus.channel("specific_force_m_s2"), stimulus, rng, state)[1:]
    true = slider.stimulus(times_s).channel("specific_force_m_s2")[1:]
    correction = 0.2 * 10 * G
    assert np.abs(bent - true).max() < 0.04 * correction
    assert np.abs(stimulus.channel("specific_force_m_s2")[1:] - true).max() > 0.9 * correction


@pytest.mark.parametrize("crank", [0, 1])
def test_the_grating_gives_the_motion_back(crank: int) -> None:
    """The calibration's fit of the rig's own stream finds what the slide did, flywheel ripple included."""
    rig = SinusoidalOverloadRig(SITE, RigErrors.drawn(4))
    run = run_of(rig, crank=crank, cycles=8)
    assert run.carriage.turn.speed_ripple > (0.02 if crank else 1e-5)
    times_s = np.arange(int(run.duration_s * run.reading_rate_hz)) / run.reading_rate_hz
    motion = half_cycles_from_grating(times_s, run.reading(times_s)["position"])
    slide = run.slide(motion.cut_s)
    np.testing.assert_allclose(slide.acceleration_m_s2, 0.0, atol=0.1)  # of 98; the fit has six harmonics
    change = np.abs(np.diff(slide.velocity_m_s)).reshape(-1, 2)
    np.testing.assert_allclose(motion.half_cycles.speed_change_m_s, change, rtol=3e-5)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"overload_g": 12.5}, "1 to 12 g"),
        ({"overload_g": 0.5}, "1 to 12 g"),
        ({"radius_m": 0.3}, "travel"),
        ({"overload_g": 12.0, "radius_m": 0.1}, "rad/s"),
        ({"overload_g": 12.0, "payload_kg": 150.0}, "W of the motor"),
        ({"axis": 1.5}, "axis cannot be 1.5"),
    ],
)
def test_what_the_rig_refuses(given, says: str) -> None:
    with pytest.raises(TestloomError, match=says) as caught:
        run_of(SinusoidalOverloadRig(SITE, stand_id="rig-7"), **given)
    assert caught.value.where == "stand rig-7"
    assert caught.value.remedy


def test_the_rigs_own_errors_are_the_seeds() -> None:
    one, same, other = (recording_stand("sinusoidal_overload_rig", seed, SITE) for seed in (1, 1, 2))
    assert one.effects == same.effects != other.effects
    names = [(effect.sensor, effect.word) for effect in one.effects]
    assert names == [(s, w) for s in ("gyro", "acc") for w in ("wobble", "remount_misalignment")]
    wobble = one.effects[0]
    assert isinstance(wobble, Wobble)
    guide = np.abs(wobble.cosine_rad)
    assert (guide < math.radians(15 / 3600)).all()
    assert guide.any()


def new_port() -> OverloadPort:
    stand = live_stand("sinusoidal_overload_rig", 1, SITE, "R-1")
    assert isinstance(stand.port, OverloadPort)
    assert stand.trigger_line is stand.port
    return stand.port


def port_at_speed(overload_g: float = 10.0) -> tuple[OverloadPort, float]:
    port = new_port()
    start_up_s = float(port.command(f"RUN {overload_g:g}", 0.0).removeprefix("OK "))
    return port, start_up_s


def test_a_live_run_from_rest_to_rest() -> None:
    port = new_port()
    assert port.command("*IDN?", 0.0) == "Testloom,SOR,R-1,1.0"
    due = recording_stand("sinusoidal_overload_rig", 1, SITE).identity.calibration_due
    assert port.command("CAL?", 0.0) == due
    assert port.command("LIM?", 0.0) == "1,12,0.15,33,2000"
    assert port.command("AXIS 3", 0.0) == "OK"
    ready_s = float(port.command("RUN 10", 0.0).removeprefix("OK "))
    assert port.command("RUN 10", 0.0) == "ERR 10 starting"
    assert port.command("HALF?", 0.5 * ready_s).startswith("ERR 14")
    assert port.command("STAT?", ready_s).startswith("RUNNING,")
    times_s = np.linspace(0.0, ready_s + 1.0, 200_001)
    force = port.rig.stimulus(times_s).channel("specific_force_m_s2")
    half = times_s > ready_s
    assert np.abs(force[half, 2]).max() == pytest.approx(10 * G, rel=2e-3)  # this rig is 2.4 % out of balance
    slide = port.rig.slide(times_s)
    speed = np.diff(slide.velocity_m_s) / np.diff(times_s)
    way = np.diff(slide.position_m) / np.diff(times_s)
    between = 0.5 * (slide.acceleration_m_s2[1:] + slide.acceleration_m_s2[:-1])
    smooth = np.abs(times_s[1:] - ready_s) > 1e-4  # where the drive stops accelerating, the force steps
    np.testing.assert_allclose(speed[smooth], between[smooth], atol=2e-3)
    np.testing.assert_allclose(way, 0.5 * (slide.velocity_m_s[1:] + slide.velocity_m_s[:-1]), atol=1e-4)
    now_s = ready_s + 1.0
    wait_s = float(port.command("ARM", now_s).removeprefix("OK "))
    at = port.rig.slide(np.array([now_s + wait_s]))
    assert abs(at.position_m[0]) < 1e-7
    stopping_s = float(port.command("STOP", now_s).removeprefix("OK "))
    assert port.command("STAT?", now_s + 0.5 * stopping_s).startswith("STOPPING,")
    assert port.command("RUN 5", now_s + 0.5 * stopping_s).startswith("ERR 10")
    assert port.command("STAT?", now_s + stopping_s).startswith("READY,0.0000000,0.0000000,")
    assert port.next_edge_s(now_s + stopping_s) is None


def test_half_cycles_as_the_grating_measures_them() -> None:
    port, ready_s = port_at_speed()
    case = BY_G[10.0]
    now_s = ready_s + 1.0
    first = port.command("HALF?", now_s).split(",")
    second = port.command("HALF?", now_s + 0.5 * case["T_s"]).split(",")
    assert {first[0], second[0]} == {"1", "-1"}
    duration, change, squared = (float(figure) for figure in first[1:])
    assert duration == pytest.approx(case["T_s"] / 2, rel=5e-4)
    assert change == pytest.approx(case["dV_gs"] * G, rel=1e-3)  # an imbalance of 2 % moves the speed
    assert squared == pytest.approx(case["S_g2s"] * G**2, rel=1e-3)


@pytest.mark.parametrize(
    ("fault", "state", "answer"),
    [("door_open", "FAULT", "ERR 13"), ("lost_reference", "NOREF", "ERR 11")],
)
def test_faults_that_stop_it(fault: str, state: str, answer: str) -> None:
    port, ready_s = port_at_speed()
    port.inject(fault, ready_s + 1.0)
    assert port.command("STAT?", ready_s + 1.1).startswith(state)
    for command in ("ARM", "HALF?"):
        assert port.command(command, ready_s + 1.1).startswith("ERR 14" if command == "ARM" else answer)
    assert port.next_edge_s(ready_s + 1.1) is None
    rest_s = ready_s + 10.0
    assert port.command("RUN 5", rest_s).startswith(answer)
    assert float(port.command("STAT?", rest_s).split(",")[2]) == 0.0
    port.inject("none", rest_s)
    assert port.command("RUN 5", rest_s).startswith("OK ")


def test_a_speed_that_is_not_reached_never_counts_as_running() -> None:
    port = new_port()
    port.inject("speed_not_reached", 0.0)
    port.command("RUN 10", 0.0)
    state, overload, *_ = port.command("STAT?", 100.0).split(",")
    assert state == "STARTING"
    assert float(overload) == pytest.approx(10 * 0.97**2, rel=2e-3)
    assert port.command("HALF?", 100.0).startswith("ERR 14")


def test_what_the_port_refuses() -> None:
    port = new_port()
    assert port.command("RUN 12.5", 0.0).startswith("ERR 12 An overload of 12.5 g")
    assert port.command("RUN ten", 0.0).startswith("ERR 2")
    assert port.command("AXIS 4", 0.0).startswith("ERR 2")
    assert port.command("STAT? 1", 0.0).startswith("ERR 2")
    assert port.command("JUMP", 0.0).startswith("ERR 1 ")
    assert port.command("ARM", 0.0).startswith("ERR 14")
    with pytest.raises(BenchModelError, match="cannot have"):
        port.inject("rate_not_reached", 0.0)


def test_the_stream_has_turntable_samples() -> None:
    port, _ = port_at_speed()
    assert port.command("STRE ON,1000", 20.0) == "OK"
    rows = np.frombuffer(port.advance(20.5), dtype="<f8").reshape(-1, 15)
    assert len(rows) == 501
    slide = port.rig.slide(rows[:, 0])
    np.testing.assert_allclose(rows[:, 14], slide.position_m, atol=3e-6)
    np.testing.assert_allclose(rows[:, 4], slide.acceleration_m_s2, rtol=3e-5, atol=1e-9)
    np.testing.assert_allclose(rows[:, 9], slide.angle_rad, atol=1e-6)
    assert port.next_event_s() == pytest.approx(20.501)
