# pyright: strict
"""A drive: straights, curves, a slalom, a hill, stops. The car leans on its springs, the road shakes it."""

import math
from collections.abc import Mapping

from dut_emulator.motion.course import Course, Timetable, Vibration
from dut_emulator.motion.path import STEEPEST, Path, Suspension
from protocol.bench_description import Site

ACCELERATION_M_S2, BRAKING_M_S2 = 2.5, 4.0
STEERING_S = 2.5
"""From straight ahead to a steady curve."""
HILL_RAD = math.radians(4.0)
HILL_S = 4.0
SUSPENSION = Suspension(roll_per_m_s2=math.radians(4.0) / 9.8, pitch_per_m_s2=math.radians(2.5) / 9.8)
"""4° of roll and 2.5° of pitch per g, as of a passenger car."""
ROAD_HZ = (1.3, 1.9, 2.7, 4.1, 6.3, 9.1, 11.7, 14.3, 21.0, 33.0, 47.0, 71.0)
"""The body on its springs near 1.5 Hz, the wheels near 12 Hz, and what the tyres let through."""
ROAD_WEIGHTS = (1.0, 0.9, 0.6, 0.4, 0.4, 0.6, 0.8, 0.6, 0.3, 0.2, 0.2, 0.1)


def drive(values: Mapping[str, float], site: Site, seed: int) -> Course:
    """The drive, beginning towards `site.heading_deg`. `seed`: of the road's phases."""
    scale, speed = values["duration_scale"], values["speed_m_s"]
    turn = values["cornering_m_s2"] / speed
    start_s, stop_s = STEEPEST * speed / ACCELERATION_M_S2, STEEPEST * speed / BRAKING_M_S2
    table = Timetable("speed", "climb", "turn")
    table.phase("rest")
    table.hold(10.0 * scale)
    table.phase("accelerate")
    table.change(start_s, speed=speed)
    table.phase("straight")
    table.hold(15.0 * scale)
    table.phase("turn")
    for rate in (turn, -turn):
        table.change(STEERING_S, turn=rate)
        table.hold(8.0 * scale)
        table.change(STEERING_S, turn=0.0)
    table.phase("slalom")
    for rate in (turn, -turn, turn, -turn, 0.0):
        table.change(STEERING_S, turn=rate)
    table.phase("hill")
    for climb in (HILL_RAD, -HILL_RAD, 0.0):
        table.change(HILL_S, climb=climb)
        table.hold(4.0 * scale)
    table.phase("stop")
    table.change(stop_s, speed=0.0)
    table.hold(5.0 * scale)
    table.phase("circling")
    table.change(start_s, speed=0.5 * speed)
    table.change(STEERING_S, turn=turn)
    table.hold(2.0 * math.pi * scale / turn)
    table.change(STEERING_S, turn=0.0)
    table.phase("stop")
    table.change(stop_s, speed=0.0)
    table.phase("rest")
    table.hold(10.0 * scale)
    path = Path(
        *(table.steps(quantity) for quantity in ("speed", "climb", "turn")),
        heading_rad=math.radians(site.heading_deg),
        latitude_deg=site.latitude_deg,
        gravity_m_s2=site.gravity_m_s2,
        suspension=SUSPENSION,
    )
    vibration = Vibration.drawn(ROAD_HZ, ROAD_WEIGHTS, values["vibration_m_s2"], seed, with_speed=speed)
    arm = (values["arm_forward_m"], values["arm_left_m"], values["arm_up_m"])
    return Course(path, tuple(table.phases), table.now_s, vibration, values["temperature_c"], arm)
