# pyright: strict
"""What a chamber is told: temperature ramps and soaks."""

from dut_emulator.motion.profile import ProfileKind, ProfileParameter

ROOM_C = 23.0

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
        "accelerometers' scale factors and biases at soak temperatures, two axes at each mount",
        (
            _COLD,
            _HOT,
            _RAMP,
            _SOAK,
            ProfileParameter("levels", 4.0, "1", 2.0, 30.0, "soak temperatures, equally spaced"),
            ProfileParameter("dwell_s", 10.0, "s", 1.0, 3600.0, "rest in each position"),
            ProfileParameter("mount", 1.0, "1", 1.0, 3.0, "body axis along the stand's: 1 x, 2 y, 3 z"),
        ),
    ),
)
