# pyright: strict
"""What the axes of a turntable are told: the profiles by name, and what fits where a stand cannot do one."""

import math
from collections.abc import Mapping

from dut_emulator.motion.axis_motion import Trapezoid
from dut_emulator.motion.profile import ProfileKind, ProfileParameter
from dut_emulator.motion.schedule import AXES, Drives, Excess

_BODY_AXIS = "body axis: 1 x, 2 y, 3 z, 0 one after the other"
_REST = ProfileParameter("rest_s", 5.0, "s", 0.0, 3600.0, "rest before and after each motion")


def _axis(default: float) -> ProfileParameter:
    return ProfileParameter("axis", default, "1", 0.0, 3.0, _BODY_AXIS)


KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "static",
        "noise, bias instability, warm-up, Earth rate",
        (ProfileParameter("duration_s", 200.0, "s", 1.0, 1e6, "how long the unit rests, z up"),),
    ),
    ProfileKind(
        "multi_position",
        "accelerometers' scale factors, biases and couplings; what depends on the place of gravity",
        (
            ProfileParameter("positions", 6.0, "1", 6.0, 24.0, "6, 12 (two headings) or 24 (four headings)"),
            ProfileParameter("dwell_s", 10.0, "s", 1.0, 36_000.0, "rest in each position"),
        ),
    ),
    ProfileKind(
        "rotation",
        "gyros' scale factors and couplings from the integral over whole turns (paper 1, section 4.2)",
        (
            ProfileParameter("angle_deg", 1080.0, "deg", 1.0, 36_000.0, "turned forth and back"),
            ProfileParameter("duration_s", 5.0, "s", 0.1, 3600.0, "of one turning, ramps included"),
            ProfileParameter("ramp_s", 2.2, "s", 0.01, 1800.0, "of each ramp"),
            _REST,
            _axis(0.0),
        ),
    ),
    ProfileKind(
        "rate_staircase",
        "gyros' scale factor, asymmetry, non-linearity, dead band, hysteresis over rate",
        (
            ProfileParameter("max_rate_deg_s", 300.0, "deg/s", 0.01, 10_000.0, "highest level, both ways"),
            ProfileParameter("steps", 5.0, "1", 1.0, 50.0, "levels from rest to the highest"),
            ProfileParameter("dwell_s", 2.0, "s", 0.1, 3600.0, "at each level, up and down"),
            _axis(0.0),
        ),
    ),
    ProfileKind(
        "tumble",
        "g-sensitivity of gyros, quadratic terms of accelerometers",
        (
            ProfileParameter("rate_deg_s", 12.0, "deg/s", 0.1, 100.0, "of the turn about a horizontal axis"),
            ProfileParameter("turns", 1.0, "1", 1.0, 1000.0, "about each axis"),
            ProfileParameter("spin_deg_s", 0.0, "deg/s", 0.0, 400.0, "of body x while body y tumbles"),
        ),
    ),
    ProfileKind(
        "swing",
        "delay against the stand, scale factors in motion (paper 2, swing test)",
        (
            ProfileParameter("amplitude_deg", 80.0, "deg", 0.1, 3600.0, "of the sine"),
            ProfileParameter("peak_rate_deg_s", 200.0, "deg/s", 0.1, 1000.0, "of the sine"),
            ProfileParameter("cycles", 15.0, "1", 1.0, 1000.0, "whole periods"),
            _axis(1.0),
        ),
    ),
    ProfileKind(
        "sweep",
        "bandwidth and delay",
        (
            ProfileParameter("low_hz", 0.1, "Hz", 0.01, 100.0, "where the sweep begins"),
            ProfileParameter("high_hz", 20.0, "Hz", 0.02, 200.0, "where it ends"),
            ProfileParameter("duration_s", 60.0, "s", 5.0, 3600.0, "of the sweep"),
            ProfileParameter("peak_rate_deg_s", 100.0, "deg/s", 0.01, 1000.0, "amplitude at low frequency"),
            ProfileParameter(
                "peak_acceleration_deg_s2", 200.0, "deg/s^2", 0.1, 10_000.0, "amplitude at high frequency"
            ),
            ProfileParameter("logarithmic", 1.0, "1", 0.0, 1.0, "1: frequency in equal ratios; 0: linear"),
            _axis(0.0),
        ),
    ),
    ProfileKind(
        "spin",
        "hard and soft iron, roll from the field, latency; gyros saturate (paper 1, section 5.4)",
        (
            ProfileParameter("max_rate_rev_s", 15.0, "rev/s", 0.01, 100.0, "highest level"),
            ProfileParameter("steps", 3.0, "1", 1.0, 50.0, "levels from rest to the highest"),
            ProfileParameter("dwell_s", 20.0, "s", 1.0, 3600.0, "at each level"),
        ),
    ),
)


def what_fits(profile: str, values: Mapping[str, float], excess: Excess, drives: Drives) -> str:
    """What to change so that the axis keeps the limit that was passed."""
    share = excess.limit / excess.asked
    match profile:
        case "rotation":
            return _fitting_turn(values, excess, drives)
        case "swing":
            if excess.quantity == "rate":
                return f"give peak_rate_deg_s of at most {excess.limit:g}."
            amplitude, rate = values["amplitude_deg"], values["peak_rate_deg_s"]
            return (
                f"give peak_rate_deg_s of at most {math.sqrt(excess.limit * amplitude):.4g} "
                f"at this amplitude, or amplitude_deg of at least {rate**2 / excess.limit:.4g} at this rate."
            )
        case "rate_staircase":
            return f"give max_rate_deg_s of at most {excess.limit:g}."
        case "spin":
            return f"give max_rate_rev_s of at most {excess.limit / 360:.4g}."
        case "sweep":
            name = f"peak_{excess.quantity}_deg_s" + ("2" if excess.quantity == "acceleration" else "")
            return f"give {name} of at most about {0.99 * share * values[name]:.3g}."
        case "tumble":
            name = "spin_deg_s" if values["spin_deg_s"] > values["rate_deg_s"] else "rate_deg_s"
            return f"give {name} of at most {excess.limit:g}."
        case "thermal_positions":
            return f"give rate_deg_s of at most {excess.limit:g}."
        case _:
            return "choose another stand."


def _fitting_turn(values: Mapping[str, float], excess: Excess, drives: Drives) -> str:
    """For a turn: the ramps that keep both limits within the duration, or the least duration.

    The peak rate is angle / (duration − ramp), the acceleration that over the ramp.
    """
    axis = AXES.index(excess.axis)
    rate, acceleration = drives.rate_deg_s[axis], drives.acceleration_deg_s2[axis]
    angle, duration_s = values["angle_deg"], values["duration_s"]
    fastest = Trapezoid.fastest(angle, rate, acceleration)
    if duration_s < fastest.duration_s:
        text = f"give at least {fastest.duration_s:.4g} s with ramps of {fastest.ramp_s:.4g} s"
    else:
        shortest_s = (duration_s - math.sqrt(duration_s**2 - 4 * angle / acceleration)) / 2
        longest_s = min(duration_s - angle / rate, duration_s / 2)
        text = f"keep the ramps above {shortest_s:.4g} s and below {longest_s:.4g} s"
    return f"{text}: the peak rate is angle / (duration − ramp), the acceleration that over the ramp."
