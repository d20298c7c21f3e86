"""Flight states from rates, forces and attitude, held against the phases that emulated runs really had."""

import math

import numpy as np

from calibration.algorithms.attitude_angles import quaternion_of_angles
from calibration.algorithms.flight_phases import STATES, flight_phases, initial_rest_samples
from calibration.evaluations.flight import PHASE_NAMES, evaluate_flight
from dut_emulator.motion.course import PHASES
from dut_emulator.recording.recorder import recorded

G = 9.80665


def test_the_phases_numbers_are_the_stands() -> None:
    assert PHASE_NAMES == PHASES


def test_a_run_made_by_hand() -> None:
    """Rest, push, level, a bank with a turn of 90 deg, one of 360 deg, pitching, brakes, rest; 10 Hz."""
    period_s = 0.1
    parts: list[tuple[float, str, tuple[float, float, float, float]]] = [
        (20.0, "rest", (0.0, 0.0, 0.0, 0.0)),  # roll, pitch rate, yaw rate (deg), forward force
        (15.0, "take_off", (0.0, 0.0, 0.0, 3.0)),
        (30.0, "cruise", (0.0, 0.0, 0.0, 0.0)),
        (15.0, "turn", (30.0, 0.0, 6.0, 0.0)),
        (20.0, "cruise", (0.0, 0.0, 0.0, 0.0)),
        (60.0, "circling", (30.0, 0.0, 6.0, 0.0)),
        (20.0, "cruise", (0.0, 0.0, 0.0, 0.0)),
        (5.0, "pitch_manoeuvre", (0.0, 2.0, 0.0, 0.0)),
        (5.0, "pitch_manoeuvre", (0.0, -2.0, 0.0, 0.0)),
        (20.0, "cruise", (0.0, 0.0, 0.0, 0.0)),
        (15.0, "landing", (0.0, 0.0, 0.0, -3.0)),
        (20.0, "rest", (0.0, 0.0, 0.0, 0.0)),
    ]
    counts = [round(duration / period_s) for duration, _, _ in parts]
    expected = np.repeat([name for _, name, _ in parts], counts)
    inputs = np.repeat([values for _, _, values in parts], counts, axis=0)
    roll, pitch = np.radians(inputs[:, 0]), np.cumsum(np.radians(inputs[:, 1])) * period_s
    yaw = np.cumsum(np.radians(inputs[:, 2])) * period_s
    attitude = quaternion_of_angles(np.stack([roll, pitch, yaw], axis=1))
    # clockwise about the vertical is -z; in a bank it shows on y and z
    rate = np.radians(inputs[:, 2:3]) * -np.stack([0 * roll, np.sin(roll), np.cos(roll)], axis=1)
    rate[:, 1] -= np.radians(inputs[:, 1])
    force = np.stack(
        [G * np.sin(pitch) + inputs[:, 3], 0 * roll, G / np.cos(roll) * np.cos(pitch)], axis=1
    )  # coordinated: nothing across
    found = flight_phases(attitude, rate, force, period_s)
    agree = found == expected
    assert agree.mean() > 0.97, list(zip(expected[~agree], found[~agree], strict=True))[:5]
    assert set(found) <= set(STATES)
    assert initial_rest_samples(rate, force, period_s) == counts[0]


def test_emulated_flights_show_their_phases() -> None:
    """Each sure phase is recognised for most of its time; a climb or descent is not taken for a turn."""
    flight = recorded("mems_ahrs", "flight", seed=3, triggered=True)
    names = evaluate_flight((flight,)).results[0].content.quantities
    assert {f"roll_error_{name}" for name in ("take_off", "cruise", "turn", "circling", "landing")} <= {
        one.name for one in names
    }
    from calibration.evaluations.attitude_sources import inertial_samples
    from calibration.evaluations.flight import _our_attitude

    dut, phases = flight.streams["dut"], flight.streams["phases"]
    states = _our_attitude(flight, dut).states
    assert len(states) == len(inertial_samples(flight, dut).time_s)
    index = np.searchsorted(phases.time_s(), dut.time_s(), side="right") - 1
    true = np.array(PHASES)[np.asarray(phases.columns["phase"], dtype=int)[index]]
    for name, least in (
        ("rest", 0.95),
        ("take_off", 0.7),
        ("cruise", 0.9),
        ("turn", 0.7),
        ("circling", 0.85),
    ):
        assert (states[true == name] == name).mean() > least, name
    for name, least in (("pitch_manoeuvre", 0.6), ("landing", 0.6)):
        assert (states[true == name] == name).mean() > least, name
    for name in ("climb", "descent", "cruise"):
        assert not np.isin(states[true == name], ["turn", "circling", "rest"]).any(), name


def test_a_unit_that_moves_from_the_start_has_no_rest() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    swaying = np.zeros((len(t), 3))
    swaying[:, 0] = math.radians(30.0) * np.sin(2.0 * t)
    level = np.tile([0.0, 0.0, G], (len(t), 1))
    assert initial_rest_samples(swaying, level, 0.01) == 0
    assert initial_rest_samples(0 * swaying, level, 0.01) == len(t)
    assert initial_rest_samples(swaying[:50], level[:50], 0.01) == 0
