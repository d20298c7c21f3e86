# pyright: strict
"""Every profile there is, by its name."""

from dut_emulator.motion import (
    chamber_profiles,
    impact_profile,
    overload_profile,
    rate_table_profile,
    satellite_profiles,
    turntable_profiles,
    vehicle_profiles,
)
from dut_emulator.motion.profile import ProfileKind
from protocol.errors import Fault, TestloomError

PROFILES: dict[str, ProfileKind] = {
    kind.name: kind
    for module in (
        turntable_profiles,
        chamber_profiles,
        rate_table_profile,
        impact_profile,
        overload_profile,
        satellite_profiles,
        vehicle_profiles,
    )
    for kind in module.KINDS
}


def profile_named(name: str) -> ProfileKind:
    """A profile by its name.

    Raises:
        TestloomError: there is none of this name.
    """
    if name not in PROFILES:
        raise TestloomError(
            f"There is no profile '{name}'.",
            where="profiles",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(PROFILES)}.",
        )
    return PROFILES[name]
