# pyright: strict
"""A turntable's own errors, drawn by its seed inside what its data sheet promises, as catalogue effects.

The stimulus holds what the stand reports; what it truly does beside that are these effects, the same for
every unit. A stand has one wobble, one ripple and one eccentricity: those of its worst axis. All stands of a
kind have the same list of effects, whatever the seed. The Earth's rate is none of them: see
`motion.laboratory`.
"""

from dataclasses import dataclass

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.dynamics import ChamberLag
from dut_emulator.effects.effect import SensorName
from dut_emulator.effects.stand import (
    AXIS_NAMES,
    AxisName,
    EncoderEccentricity,
    LevelDrift,
    LeverArm,
    NonOrthogonality,
    RateRipple,
    RateScaleFactor,
    RemountMisalignment,
    Wobble,
)
from dut_emulator.effects.stand_surroundings import ChamberGradient, MotorField
from dut_emulator.motion.chamber import ROOM_C
from dut_emulator.motion.schedule import Drives
from dut_emulator.stands.stand_draws import StandDraws
from protocol.units_of_measure import factor_to_si

ARC_SECOND_RAD = factor_to_si("arcsec")
_TRIADS: tuple[SensorName, ...] = ("gyro", "acc", "mag")


@dataclass(frozen=True)
class TurntableSpec:
    """What a data sheet promises: the largest amplitude of each error; a drawn one has 30 to 100 % of it."""

    wobble_rad: float = 2 * ARC_SECOND_RAD
    eccentricity_rad: float = 2 * ARC_SECOND_RAD
    rate_ripple: float = 2e-5
    ripple_harmonic: float = 12.0
    non_orthogonality_rad: float = 2 * ARC_SECOND_RAD
    rate_scale_factor: float = 5e-6
    level_drift_rad_s: float = 1e-8
    remount_misalignment_rad: float = 1e-4
    lever_arm_m: float = 2e-3
    motor_field_t: float = 1e-6
    chamber_lag_s: float = 0.0
    chamber_gradient: float = 0.0


def drawn_effects(kind: str, seed: int, spec: TurntableSpec, drives: Drives) -> tuple[CatalogueEffect, ...]:
    """The errors of the stand of this kind and seed, on every triad that they reach."""
    draws = StandDraws(kind, seed)
    driven: list[AxisName] = [name for index, name in enumerate(AXIS_NAMES) if drives.turns(index)]
    worst = driven[int(draws.generator("worst axis").integers(len(driven)))]
    turning = _rotations(draws, spec, drives, worst)
    ripple_cosine, ripple_sine = draws.wave("rate ripple", spec.rate_ripple)
    drift_x, drift_y = draws.wave("level drift", spec.level_drift_rad_s)
    tilt = (drift_x, drift_y, 0.0)
    effects: list[CatalogueEffect] = [
        RateScaleFactor("gyro", draws.signed("rate scale factor", spec.rate_scale_factor)),
        RateRipple("gyro", ripple_cosine, ripple_sine, spec.ripple_harmonic, worst),
        *(effect for row in turning for effect in row),
        LevelDrift("gyro", tilt),
        LevelDrift("acc", tilt),
        LeverArm("acc", draws.vector("lever arm", spec.lever_arm_m)),
        MotorField(
            "mag",
            draws.vector("motor field cosine", spec.motor_field_t),
            draws.vector("motor field sine", spec.motor_field_t),
            1.0,
            worst,
        ),
    ]
    if spec.chamber_lag_s:
        share = -draws.size("chamber gradient", spec.chamber_gradient)
        effects += [
            ChamberGradient("temperature", (share, share, share), ROOM_C),
            ChamberLag("temperature", draws.size("chamber lag", spec.chamber_lag_s)),
        ]
    return tuple(effects)


def _rotations(
    draws: StandDraws, spec: TurntableSpec, drives: Drives, worst: AxisName
) -> list[tuple[CatalogueEffect, ...]]:
    """The small rotations of the body, for each triad the same."""
    nod_cosine = draws.vector("wobble cosine", spec.wobble_rad)
    nod_sine = draws.vector("wobble sine", spec.wobble_rad)
    off_cosine, off_sine = draws.wave("eccentricity", spec.eccentricity_rad)
    mounted = draws.vector("remount", spec.remount_misalignment_rad)
    outer_middle = draws.signed("outer middle", spec.non_orthogonality_rad)
    middle_inner = draws.signed("middle inner", spec.non_orthogonality_rad)
    square = (drives.turns(0) and drives.turns(1), drives.turns(1) and drives.turns(2))
    rows: list[tuple[CatalogueEffect, ...]] = []
    for triad in _TRIADS:
        row: list[CatalogueEffect] = [
            Wobble(triad, nod_cosine, nod_sine, 1.0, worst),
            EncoderEccentricity(triad, off_cosine, off_sine, worst),
            RemountMisalignment(triad, mounted),
        ]
        if any(square):
            row.append(NonOrthogonality(triad, outer_middle * square[0], middle_inner * square[1]))
        rows.append(tuple(row))
    return rows
