# pyright: strict
"""Sinusoidal linear acceleration on a crank (paper 5)."""

from dut_emulator.motion.profile import ProfileKind, ProfileParameter

SCOTCH_YOKE, SLIDER_CRANK = 0, 1

KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "overload",
        "asymmetry and odd quadratic non-linearity of accelerometers, g-sensitivity of gyros, above 1 g",
        (
            ProfileParameter("overload_g", 10.0, "g", 0.1, 30.0, "r ω²: the amplitude of the fundamental"),
            ProfileParameter("cycles", 40.0, "1", 1.0, 10_000.0, "whole cycles after the first zero mark"),
            ProfileParameter("axis", 1.0, "1", 1.0, 3.0, "body axis along the stroke: 1 x, 2 y, 3 z"),
            ProfileParameter(
                "crank", SCOTCH_YOKE, "1", 0.0, 1.0, "0 scotch yoke (a sinusoid), 1 slider-crank"
            ),
            ProfileParameter("rod_ratio", 0.2, "1", 0.01, 0.5, "r / b of the slider-crank"),
            ProfileParameter("radius_m", 0.15, "m", 0.01, 1.0, "crank radius r, half the stroke"),
            ProfileParameter("payload_kg", 45.0, "kg", 1.0, 500.0, "unit with its fixture"),
            ProfileParameter(
                "counter_share", 1.0, "1", 0.0, 2.0, "mass of the counter-slide over that of the slide"
            ),
        ),
    ),
)
"""Of paper 5, 5.2: y vertical with x along the stroke; x vertical with y or z along it."""
