# pyright: strict
"""A flight: take-off, climb, cruise, turns, circling, pitch manoeuvres, descent, landing.

Every phase is a change of speed, climb angle, turn rate or incidence that takes as long as a pilot's limits
ask for; between the changes all of them are steady. The wings bank as the turn asks (`Path`).
"""

import math
from collections.abc import Mapping

import numpy as np

from dut_emulator.motion.course import Course, Timetable, Vibration
from dut_emulator.motion.path import STEEPEST, Path
from protocol.bench_description import Site

LIFT_OFF_SHARE = 0.75
"""Speeds at lift-off and touch-down, over that of the cruise."""
ACCELERATION_M_S2 = 4.0
"""Largest of the take-off run and of the brakes."""
ROLL_RATE_RAD_S = math.radians(15.0)
PULL_UP_M_S2 = 5.0
"""Largest that a change of the climb angle adds to gravity."""
LEAST_CHANGE_S = 3.0
CLIMB_RAD, DESCENT_RAD, MANOEUVRE_RAD = math.radians(7.0), math.radians(-4.0), math.radians(8.0)
INCIDENCE_RAD = math.radians(6.0)
"""At lift-off and touch-down; none in the cruise."""
ENGINE_HZ = (13.0, 40.0, 80.0, 160.0)
"""An airframe's bending, the crankshaft at 2400/min, two blades' passing and its second harmonic."""
ENGINE_WEIGHTS = (0.4, 0.5, 1.0, 0.5)


def flight(values: Mapping[str, float], site: Site, seed: int) -> Course:
    """The flight along the runway `site.heading_deg`. `seed`: of the vibration's phases."""
    descent_s = 30.0 * values["duration_scale"]
    course = _flight(values, site, seed, descent_s)
    height_m = float(course.path.position_local_m(np.array([course.duration_s]))[0, 2])
    # a steady descent more or less brings the end onto the runway, exactly
    descent_s += height_m / (values["speed_m_s"] * LIFT_OFF_SHARE * -math.sin(DESCENT_RAD))
    return _flight(values, site, seed, descent_s)


def _flight(values: Mapping[str, float], site: Site, seed: int, descent_s: float) -> Course:
    scale, speed, bank = values["duration_scale"], values["speed_m_s"], math.radians(values["bank_deg"])
    slow = LIFT_OFF_SHARE * speed
    turn = site.gravity_m_s2 * math.tan(bank) / speed
    run_s = STEEPEST * slow / ACCELERATION_M_S2
    roll_s = max(LEAST_CHANGE_S, STEEPEST * bank / ROLL_RATE_RAD_S)
    table = Timetable("speed", "climb", "turn", "incidence")

    def pitch_s(change_rad: float) -> float:
        return max(LEAST_CHANGE_S, STEEPEST * speed * abs(change_rad) / PULL_UP_M_S2)

    table.phase("rest")
    table.hold(10.0 * scale)
    table.phase("take_off")
    table.change(run_s, speed=slow)
    table.change(LEAST_CHANGE_S, incidence=INCIDENCE_RAD)
    table.phase("climb")
    table.change(pitch_s(CLIMB_RAD), climb=CLIMB_RAD)
    table.hold(values["height_m"] / (slow * math.sin(CLIMB_RAD)))
    table.change(pitch_s(CLIMB_RAD), climb=0.0)
    table.change(2.0 * STEEPEST * (speed - slow) / ACCELERATION_M_S2, speed=speed, incidence=0.0)
    table.phase("cruise")
    table.hold(20.0 * scale)
    table.phase("turn")
    for rate in (turn, -turn):
        table.change(roll_s, turn=rate)
        table.hold(15.0 * scale)
        table.change(roll_s, turn=0.0)
    table.phase("circling")
    table.change(roll_s, turn=turn)
    table.hold(2.0 * math.pi * scale / turn)
    table.change(roll_s, turn=0.0)
    table.phase("pitch_manoeuvre")
    for climb in (MANOEUVRE_RAD, -MANOEUVRE_RAD, 0.0):
        table.change(pitch_s(2.0 * MANOEUVRE_RAD), climb=climb)
    table.phase("descent")
    table.change(2.0 * STEEPEST * (speed - slow) / ACCELERATION_M_S2, speed=slow, incidence=INCIDENCE_RAD)
    table.change(pitch_s(DESCENT_RAD), climb=DESCENT_RAD)
    table.hold(descent_s)
    table.phase("landing")
    table.change(pitch_s(DESCENT_RAD), climb=0.0)
    table.change(LEAST_CHANGE_S, incidence=0.0)
    table.change(run_s, speed=0.0)
    table.phase("rest")
    table.hold(10.0 * scale)
    path = Path(
        *(table.steps(quantity) for quantity in ("speed", "climb", "turn", "incidence")),
        heading_rad=math.radians(site.heading_deg),
        latitude_deg=site.latitude_deg,
        gravity_m_s2=site.gravity_m_s2,
    )
    vibration = Vibration.drawn(ENGINE_HZ, ENGINE_WEIGHTS, values["vibration_m_s2"], seed)
    arm = (values["arm_forward_m"], values["arm_left_m"], values["arm_up_m"])
    return Course(path, tuple(table.phases), table.now_s, vibration, values["temperature_c"], arm)
