# pyright: strict
"""What a chamber, and the axis inside it, are told: temperature ramps, soaks, positions, rates.

The stand's axis is horizontal. With body x along it, it reaches y and z up and down; the unit is mounted
again, with body y or z along it, for the others: each mount is a recording of its own.
"""

from collections.abc import Mapping

import numpy as np

from dut_emulator.motion.axis_pieces import staircase_pieces
from dut_emulator.motion.chamber import ROOM_C, AirPath
from dut_emulator.motion.profile import ProfileKind, ProfileParameter
from dut_emulator.motion.schedule import Drives, Schedule, ScheduleBuilder
from protocol.errors import Fault, TestloomError

QUARTER_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)

_COLD = ProfileParameter("cold_c", -40.0, "degC", -60.0, ROOM_C, "coldest soak")
_HOT = ProfileParameter("hot_c", 70.0, "degC", ROOM_C, 100.0, "hottest soak")
_RAMP = ProfileParameter("ramp_c_per_min", 3.0, "degC/min", 0.05, 20.0, "speed of the ramps")
_SOAK = ProfileParameter("soak_s", 1200.0, "s", 0.0, 86_400.0, "how long each temperature is kept")

KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "temperature_ramp",
        "biases over temperature, both ways: their hysteresis, and what follows the speed of the ramp",
        (_COLD, _HOT, _RAMP, _SOAK),
    ),
    ProfileKind(
        "thermal_positions",
        "scale factors and biases at soak temperatures: accelerometers' of two axes, a gyro's of the third",
        (
            _COLD,
            _HOT,
            _RAMP,
            _SOAK,
            ProfileParameter("levels", 4.0, "1", 2.0, 30.0, "soak temperatures, equally spaced"),
            ProfileParameter("dwell_s", 10.0, "s", 1.0, 3600.0, "rest in each position, and at each rate"),
            ProfileParameter(
                "rate_deg_s", 0.0, "deg/s", 0.0, 400.0, "then turned forth and back at this rate; 0: not"
            ),
            ProfileParameter("mount", 1.0, "1", 1.0, 3.0, "body axis along the stand's: 1 x, 2 y, 3 z"),
        ),
    ),
)


def chamber_schedule(
    profile: str, values: Mapping[str, float], drives: Drives, axis: int
) -> tuple[Schedule, AirPath]:
    """What the axis of this index and the air do in one of `KINDS`; limits are not looked at.

    Raises:
        TestloomError: a number that should be whole is not.
    """
    ramp, soak_s = values["ramp_c_per_min"], values["soak_s"]
    builder = ScheduleBuilder(drives)
    if profile == "temperature_ramp":
        targets = (values["cold_c"], values["hot_c"], ROOM_C)
        air = AirPath.through(ROOM_C, [(target, ramp, soak_s) for target in targets])
        builder.rest(air.times_s[-1])
        return builder.schedule(), air
    levels = np.linspace(values["cold_c"], values["hot_c"], _whole(profile, values, "levels")).tolist()
    legs: list[tuple[float, float, float]] = []
    present_c, rate = ROOM_C, values["rate_deg_s"]
    for target in levels:
        builder.rest(abs(target - present_c) * 60.0 / ramp + soak_s)
        began_s = builder.now_s
        for turn in QUARTER_TURNS_DEG:
            builder.move({axis: drives.home_deg[axis] + turn})
            builder.rest(values["dwell_s"])
        if rate:
            levels_deg_s = (rate, 0.0, -rate, 0.0)
            acceleration = drives.positioning_acceleration_deg_s2
            turning = staircase_pieces(levels_deg_s, values["dwell_s"], acceleration, builder.angle(axis))
            builder.go(axis, *turning)
        legs.append((target, ramp, soak_s + builder.now_s - began_s))
        present_c = target
    return builder.schedule(), AirPath.through(ROOM_C, legs)


def _whole(profile: str, values: Mapping[str, float], name: str) -> int:
    if values[name] != round(values[name]):
        raise TestloomError(
            f"{name} cannot be {values[name]:g}.",
            where=f"profile {profile}",
            fault=Fault.OPERATOR,
            remedy="give a whole number.",
        )
    return round(values[name])
