# pyright: strict
"""The schedule that each profile of a turntable makes.

A profile speaks of body axes; the stand's drives say which of its axes can turn one of them, and in what
pose: body x by the inner axis, y by the middle one, z by the outer one or, where that has no drive, by the
middle one with the inner at −90°.
"""

from collections.abc import Callable, Mapping

from dut_emulator.motion.axis_motion import Trapezoid
from dut_emulator.motion.axis_pieces import Piece, Sine, Sweep, staircase_pieces, turn_pieces
from dut_emulator.motion.schedule import AXES, Drives, Schedule, ScheduleBuilder
from protocol.errors import Fault, TestloomError

_OUTER, _MIDDLE, _INNER = range(3)
_SETTLE_S = 2.0
"""Rest between motions where a profile does not say."""

Values = Mapping[str, float]
Pose = dict[int, float]


def schedule_of(profile: str, values: Values, drives: Drives) -> Schedule:
    """What the axes do in a profile on a stand with these drives; the limits are not looked at.

    Args:
        profile: one of `turntable_profiles.KINDS`.
        values: all of its parameters.
        drives: of the stand.

    Raises:
        TestloomError: the stand has no axis for it, or the parameters contradict each other.
    """
    builder = ScheduleBuilder(drives)
    _BUILDERS[profile](builder, values, drives)
    return builder.schedule()


def _static(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    del drives
    builder.rest(values["duration_s"])


def _multi_position(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    for pose in _positions(_whole("multi_position", values, "positions"), drives):
        builder.move(pose)
        builder.rest(values["dwell_s"])


def _rotation(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    duration_s, ramp_s = values["duration_s"], values["ramp_s"]
    if 2 * ramp_s > duration_s:
        raise _refused(
            "rotation", f"Two ramps of {ramp_s:g} s do not fit in {duration_s:g} s.", "shorten them."
        )
    for axis, pose in _turned("rotation", values, drives):
        builder.move(pose)
        for angle in (values["angle_deg"], -values["angle_deg"]):
            builder.rest(values["rest_s"])
            builder.go(axis, *turn_pieces(Trapezoid(angle, duration_s, ramp_s), builder.angle(axis)))
            builder.rest(values["rest_s"])


def _rate_staircase(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    steps = _whole("rate_staircase", values, "steps")
    up = [values["max_rate_deg_s"] * step / steps for step in range(1, steps + 1)]
    there_and_back = [*up, *up[-2::-1]]
    levels = (*there_and_back, 0.0, *(-level for level in there_and_back), 0.0)
    for axis, pose in _turned("rate_staircase", values, drives):
        _climb(builder, drives, axis, pose, (levels, values["dwell_s"]))


def _spin(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    steps = _whole("spin", values, "steps")
    levels = (*(360 * values["max_rate_rev_s"] * step / steps for step in range(1, steps + 1)), 0.0)
    for axis, pose in _turned("spin", {"axis": 3.0}, drives):
        _climb(builder, drives, axis, pose, (levels, values["dwell_s"]))


def _climb(
    builder: ScheduleBuilder,
    drives: Drives,
    axis: int,
    pose: Pose,
    stairs: tuple[tuple[float, ...], float],
) -> None:
    """Levels and dwell of a staircase, from rest to rest; the last level is 0."""
    levels, dwell_s = stairs
    acceleration = drives.positioning_acceleration_deg_s2
    builder.move(pose)
    builder.rest(_SETTLE_S)
    builder.go(axis, *staircase_pieces(levels, dwell_s, acceleration, builder.angle(axis)))


def _tumble(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    acceleration = drives.positioning_acceleration_deg_s2
    turn = Trapezoid.fastest(360.0 * values["turns"], values["rate_deg_s"], acceleration)
    spin = values["spin_deg_s"]
    horizontal = [axis for axis in (_INNER, _MIDDLE) if drives.turns(axis)]
    if not horizontal or (spin and len(horizontal) < 2):
        text = "has too few horizontal axes to tumble on."
        raise _refused("tumble", f"The stand {text}", "choose a two-axis or a three-axis turntable.")
    for axis in horizontal:
        builder.move(dict.fromkeys(horizontal, 0.0))
        builder.rest(_SETTLE_S)
        motions: dict[int, tuple[Piece, ...]] = {axis: turn_pieces(turn, builder.angle(axis))}
        if spin and axis == _MIDDLE:
            ramp_s = min(spin / acceleration, turn.duration_s / 2)
            whole = Trapezoid(spin * (turn.duration_s - ramp_s), turn.duration_s, ramp_s)
            motions[_INNER] = turn_pieces(whole, builder.angle(_INNER))
        builder.together(motions)
    builder.rest(_SETTLE_S)


def _swing(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    amplitude = values["amplitude_deg"]
    cycles = _whole("swing", values, "cycles")
    for axis, pose in _turned("swing", values, drives):
        builder.move(pose)
        builder.rest(_SETTLE_S)
        way = Trapezoid.fastest(
            -amplitude, drives.positioning_rate_deg_s, drives.positioning_acceleration_deg_s2
        )
        centre = builder.angle(axis)
        builder.go(axis, *turn_pieces(way, centre))
        builder.rest(_SETTLE_S)
        builder.go(axis, Sine(cycles, centre, amplitude, values["peak_rate_deg_s"] / amplitude))
        builder.rest(_SETTLE_S)
        back = Trapezoid(amplitude, way.duration_s, way.ramp_s)
        builder.go(axis, *turn_pieces(back, builder.angle(axis)))
        builder.rest(_SETTLE_S)


def _sweep(builder: ScheduleBuilder, values: Values, drives: Drives) -> None:
    if values["low_hz"] >= values["high_hz"]:
        raise _refused("sweep", "The sweep ends below the frequency it begins with.", "raise high_hz.")
    for axis, pose in _turned("sweep", values, drives):
        builder.move(pose)
        builder.rest(_SETTLE_S)
        sweep = Sweep(
            values["duration_s"],
            builder.angle(axis),
            values["low_hz"],
            values["high_hz"],
            values["peak_rate_deg_s"],
            values["peak_acceleration_deg_s2"],
            logarithmic=bool(_whole("sweep", values, "logarithmic")),
        )
        builder.go(axis, sweep)
        builder.rest(_SETTLE_S)


_BUILDERS: dict[str, Callable[[ScheduleBuilder, Values, Drives], None]] = {
    "static": _static,
    "multi_position": _multi_position,
    "rotation": _rotation,
    "rate_staircase": _rate_staircase,
    "tumble": _tumble,
    "swing": _swing,
    "sweep": _sweep,
    "spin": _spin,
}


def _turned(profile: str, values: Values, drives: Drives) -> list[tuple[int, Pose]]:
    """For each body axis that is to turn: the stand's axis, and the pose of the others."""
    wanted = _whole(profile, values, "axis")
    ways: dict[int, list[tuple[int, Pose]]] = {
        1: [(_INNER, {_MIDDLE: 0.0})],
        2: [(_MIDDLE, {_INNER: 0.0})],
        3: [(_OUTER, {_MIDDLE: 0.0, _INNER: 0.0}), (_MIDDLE, {_INNER: -90.0})],
    }
    possible = {
        body: (axis, {other: angle for other, angle in pose.items() if drives.turns(other)})
        for body, candidates in ways.items()
        for axis, pose in reversed(candidates)
        if drives.turns(axis) and _reachable(pose, drives)
    }
    chosen = [body for body in possible if wanted in (0, body)]
    if not chosen:
        text = f"The stand cannot turn body {'xyz'[wanted - 1]}." if wanted else "The stand turns no axis."
        could = ", ".join(str(body) for body in possible)
        remedy = f"give axis {could}, or choose another stand." if could else "choose another stand."
        raise _refused(profile, text, remedy)
    return [possible[body] for body in chosen]


def _positions(count: int, drives: Drives) -> list[Pose]:
    """Poses with each body axis up, then down: x up, x down, y up, … ; then again at other headings.

    The second heading is the first turned by 180° about the vertical, which middle and inner axis can do;
    the third and fourth take the outer one.
    """
    first: list[Pose] = [
        {_MIDDLE: -90.0, _INNER: 0.0},
        {_MIDDLE: 90.0, _INNER: 0.0},
        {_MIDDLE: 0.0, _INNER: 90.0},
        {_MIDDLE: 0.0, _INNER: -90.0},
        {_MIDDLE: 0.0, _INNER: 0.0},
        {_MIDDLE: 180.0, _INNER: 0.0},
    ]
    second: list[Pose] = [
        {_MIDDLE: -90.0, _INNER: 180.0},
        {_MIDDLE: 90.0, _INNER: 180.0},
        {_MIDDLE: 180.0, _INNER: -90.0},
        {_MIDDLE: 180.0, _INNER: 90.0},
        {_MIDDLE: 180.0, _INNER: 180.0},
        {_MIDDLE: 0.0, _INNER: 180.0},
    ]
    both = first + second
    by_count = {6: first, 12: both, 24: both + [{_OUTER: 90.0, **pose} for pose in both]}
    if count not in by_count:
        raise _refused("multi_position", f"There is no set of {count} positions.", "give 6, 12 or 24.")
    needed = {axis for pose in by_count[count] for axis in pose}
    missing = [AXES[axis] for axis in sorted(needed) if not drives.turns(axis)]
    if missing:
        text = f"{count} positions take the {' and the '.join(missing)} axis, which the stand does not have."
        fewer = "give fewer positions, or " if missing == ["outer"] else ""
        raise _refused("multi_position", text, f"{fewer}choose another stand.")
    return by_count[count]


def _reachable(pose: Pose, drives: Drives) -> bool:
    return all(drives.turns(axis) or drives.home_deg[axis] == angle for axis, angle in pose.items())


def _whole(profile: str, values: Values, name: str) -> int:
    if values[name] != round(values[name]):
        raise _refused(profile, f"{name} cannot be {values[name]:g}.", "give a whole number.")
    return round(values[name])


def _refused(profile: str, what: str, remedy: str) -> TestloomError:
    return TestloomError(what, where=f"profile {profile}", fault=Fault.OPERATOR, remedy=remedy)
