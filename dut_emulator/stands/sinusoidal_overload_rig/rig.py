# pyright: strict
"""The sinusoidal overload rig of paper 5 for recordings: its limits, its own errors, its runs.

The overload is r ω² in units of standard gravity: the amplitude of the fundamental. A slider-crank peaks
1 + λ times as high at one end and 1 − λ as high (or a little less) at the other.

Own errors: the crank's radius, the mean speed and the balance of the slides (the grating sees them), the
grating's length (nobody does), the guide's pitch, roll and yaw over the stroke ('stand.wobble' of the crank's
angle: couples gravity into the axes, turns the gyros), how the unit sits ('stand.remount_misalignment'). The
guide's rotation is drawn in body axes: another mounting has another centre of mass on the air bearing.

Omitted: bending of slide and rod, vibration of the motor, the belt's elasticity, the heating by friction.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName
from dut_emulator.effects.parameters import ZERO, Triple
from dut_emulator.effects.stand import RemountMisalignment, Wobble
from dut_emulator.motion.crank import Crank, CrankTurn
from dut_emulator.motion.overload_profile import SLIDER_CRANK
from dut_emulator.stands.recording_stand import StandIdentity, beyond_limit
from dut_emulator.stands.sinusoidal_overload_rig.carriage import Carriage, Grating
from dut_emulator.stands.sinusoidal_overload_rig.drive import Drive, DriveFigures, drive_figures
from dut_emulator.stands.sinusoidal_overload_rig.overload_run import OverloadRun
from dut_emulator.stands.stand_draws import StandDraws
from protocol.bench_description import Site
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

KIND = "sinusoidal_overload_rig"
_ARC_SECOND_RAD = math.radians(1.0 / 3600.0)
_TRIADS: tuple[SensorName, ...] = ("gyro", "acc")


@dataclass(frozen=True)
class RigLimits:
    """What may be asked. `half_travel_m`: of the guide."""

    least_g: float = 1.0
    most_g: float = 12.0
    half_travel_m: float = 0.16
    speed_rad_s: float = 33.0


@dataclass(frozen=True)
class RigErrors:
    """See the module; all relative but the angles, which are in body axes."""

    radius: float = 0.0
    speed: float = 0.0
    balance: float = 0.0
    grating: Grating = field(default_factory=Grating)
    guide_rad: Triple = ZERO
    mount_rad: Triple = ZERO

    @staticmethod
    def drawn(seed: int) -> "RigErrors":
        """Of the rig of this seed: 10 µm of radius, 10 ppm of speed, 5 ppm of length, 2 % of balance."""
        draws = StandDraws(KIND, seed)
        return RigErrors(
            draws.normal("radius", 7e-5),
            draws.normal("speed", 1e-5),
            draws.normal("balance", 0.02),
            Grating(draws.normal("length", 5e-6)),
            draws.triple("guide", 3.0 * _ARC_SECOND_RAD),
            draws.triple("remount", 1e-4),
        )

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """As they act on gyros and accelerometers."""
        return tuple(
            effect
            for sensor in _TRIADS
            for effect in (
                Wobble(sensor, cosine_rad=self.guide_rad),
                RemountMisalignment(sensor, self.mount_rad),
            )
        )


@dataclass(frozen=True)
class SinusoidalOverloadRig:
    """See `RecordingStand`."""

    site: Site
    errors: RigErrors = field(default_factory=RigErrors)
    drive: Drive = field(default_factory=Drive)
    limits: RigLimits = field(default_factory=RigLimits)
    stand_id: str = "overload-rig"
    calibration_due: str = "2027-06-30"

    @property
    def identity(self) -> StandIdentity:
        """Which rig it is."""
        return StandIdentity(KIND, self.stand_id, self.calibration_due)

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Of the guide and the mounting."""
        return self.errors.effects

    def run(self, profile: str, values: Mapping[str, float]) -> OverloadRun:
        """One run of the profile `overload`, recorded when the speed has settled.

        Raises:
            TestloomError: another profile; an axis, a crank or a number of cycles that is not whole; less or
                more than the rig's overload, travel, speed or power.
        """
        if profile != "overload":
            raise beyond_limit(self.stand_id, f"The rig has no profile '{profile}'.", "use 'overload'.")
        for name in ("axis", "crank", "cycles"):
            if values[name] != round(values[name]):
                what = f"{name} cannot be {values[name]:g}."
                raise beyond_limit(self.stand_id, what, "give a whole number.")
        crank = Crank(values["radius_m"], values["rod_ratio"] if values["crank"] == SLIDER_CRANK else 0.0)
        speed = self.checked_speed_rad_s(
            crank, values["overload_g"], values["payload_kg"], values["counter_share"]
        )
        true = Crank(crank.radius_m * (1.0 + self.errors.radius), crank.ratio)
        share = values["counter_share"] * (1.0 + self.errors.balance)
        return OverloadRun(
            carriage=Carriage(
                turn=CrankTurn(self.drive.flywheel(true, values["payload_kg"], share)),
                site=self.site,
                axis=round(values["axis"]),
                grating=self.errors.grating,
            ),
            speed_rad_s=speed * (1.0 + self.errors.speed),
            cycles=round(values["cycles"]),
            mark_rad=true.force_free_angle_rad(),
        )

    def checked_speed_rad_s(
        self, crank: Crank, overload_g: float, payload_kg: float, counter_share: float
    ) -> float:
        """ω = √(overload / r).

        Raises:
            TestloomError: beyond a limit; says which, by how much and what would fit.
        """
        limits = self.limits
        if not limits.least_g <= overload_g <= limits.most_g:
            what = f"An overload of {overload_g:g} g is outside {limits.least_g:g} to {limits.most_g:g} g."
            raise beyond_limit(self.stand_id, what, f"ask {limits.least_g:g} to {limits.most_g:g} g.")
        speed = math.sqrt(overload_g * STANDARD_GRAVITY_M_S2 / crank.radius_m)
        if crank.radius_m > limits.half_travel_m:
            what = f"A crank of {crank.radius_m:g} m goes beyond the travel of ±{limits.half_travel_m:g} m."
            raise beyond_limit(self.stand_id, what, f"use a crank of up to {limits.half_travel_m:g} m.")
        if speed > limits.speed_rad_s:
            most_g = limits.speed_rad_s**2 * crank.radius_m / STANDARD_GRAVITY_M_S2
            what = (
                f"{overload_g:g} g take {speed:.1f} rad/s of the crank, above {limits.speed_rad_s:g} rad/s."
            )
            raise beyond_limit(self.stand_id, what, f"ask up to {most_g:.2f} g, or use a longer crank.")
        figures = self.figures(crank, speed, payload_kg, counter_share)
        if not math.isfinite(figures.start_up_s):
            what = (
                f"{overload_g:g} g with {payload_kg:g} kg take {figures.mean_power_w:.0f} W of the motor, "
                f"which has {self.drive.motor_power_w:.0f} W."
            )
            raise beyond_limit(self.stand_id, what, "ask a lower overload, or take off load.")
        return speed

    def figures(
        self, crank: Crank, speed_rad_s: float, payload_kg: float, counter_share: float
    ) -> DriveFigures:
        """Energy and power of a mean speed."""
        flywheel = self.drive.flywheel(crank, payload_kg, counter_share)
        return drive_figures(self.drive, flywheel, speed_rad_s, self.site.gravity_m_s2)
