# pyright: strict
"""Drives and flights."""

from dut_emulator.motion.profile import ProfileKind, ProfileParameter

_COMMON = (
    ProfileParameter("duration_scale", 1.0, "1", 0.2, 20.0, "factor of all steady stretches"),
    ProfileParameter("temperature_c", 23.0, "degC", -40.0, 60.0, "of the air at the start"),
    ProfileParameter("arm_forward_m", 0.0, "m", -10.0, 10.0, "from the centre to the unit, forward"),
    ProfileParameter("arm_left_m", 0.0, "m", -10.0, 10.0, "from the centre to the unit, to the left"),
    ProfileParameter("arm_up_m", 0.0, "m", -10.0, 10.0, "from the centre to the unit, up"),
)

KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "vehicle_run",
        "attitude and heading on the road: what a filter makes of curves, hills, braking and shaking",
        (
            ProfileParameter("speed_m_s", 15.0, "m/s", 2.0, 60.0, "on the straight"),
            ProfileParameter("cornering_m_s2", 2.5, "m/s^2", 0.2, 10.0, "across, in a steady curve"),
            ProfileParameter("vibration_m_s2", 0.5, "m/s^2", 0.0, 20.0, "of the road at that speed, rms"),
            *_COMMON,
        ),
    ),
    ProfileKind(
        "flight",
        "attitude in flight: a coordinated turn leaves no force across, so a filter without gates takes the "
        "bank for level; take-off and pull-ups mislead its pitch (paper 2)",
        (
            ProfileParameter("speed_m_s", 60.0, "m/s", 20.0, 200.0, "of the cruise"),
            ProfileParameter("bank_deg", 30.0, "deg", 5.0, 75.0, "of turns and circling"),
            ProfileParameter(
                "height_m", 300.0, "m", 50.0, 5000.0, "about that of the cruise, above the runway"
            ),
            ProfileParameter("vibration_m_s2", 1.0, "m/s^2", 0.0, 50.0, "of engine and airframe, rms"),
            *_COMMON,
        ),
    ),
)
"""Axes and signs are in `motion.path`, the phases' numbers in `motion.course`."""
