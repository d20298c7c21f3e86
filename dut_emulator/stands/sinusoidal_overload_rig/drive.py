# pyright: strict
"""Energy and power of the overload rig: what the motor has to give, and what goes to and fro without it.

A slide at crank angle θ and even speed ω takes the power m x' x'' ω³ and gives it back a quarter turn later:
for a yoke m r² ω³ sin θ cos θ. Two slides a quarter turn apart give it to each other (paper 5, 2.2), the
flywheel takes what is left, and the motor makes up for friction:

    rolling μ m g |v|  +  drag c v²  +  (1 − η) |m v a| of what passes through pins and guides,   each slide.

Starting takes constant angular acceleration at which the motor's power just suffices when speed is reached:
t = 2 E / (P − mean friction).
"""

import math
from dataclasses import dataclass

import numpy as np

from dut_emulator.motion.crank import Crank, CrankTurn, FloatArray, Flywheel

_TURN = np.arange(1440, dtype=np.float64) * (2.0 * math.pi / 1440)
MAX_START_RAD_S2 = 6.0
"""However strong the motor is: the belt."""


@dataclass(frozen=True)
class Drive:
    """The moving parts and the motor.

    Attributes:
        table_kg: of the slide without its load.
        inertia_kg_m2: flywheel and gear, seen from the crank.
        rolling: coefficient μ of the upper guide; the air bearing has none.
        drag_n_s_m: c of one slide.
        passing_loss: 1 − η.
        motor_power_w: at the crank.
    """

    table_kg: float = 60.0
    inertia_kg_m2: float = 20.0
    rolling: float = 0.003
    drag_n_s_m: float = 20.0
    passing_loss: float = 0.03
    motor_power_w: float = 2000.0

    def flywheel(self, crank: Crank, payload_kg: float, counter_share: float) -> Flywheel:
        """What turns with this load; the counter-slide has so many times the slide's mass."""
        slide_kg = self.table_kg + payload_kg
        return Flywheel(crank, self.inertia_kg_m2, slide_kg, counter_share * slide_kg)


@dataclass(frozen=True)
class DriveFigures:
    """What an overload takes.

    Attributes:
        mean_power_w, peak_power_w: of the motor at speed: friction.
        slide_swing_w: largest power that one slide gives and takes; the motor's if there were no exchange.
        flywheel_swing_w: what of both slides' is left for the flywheel.
        kinetic_energy_j: of everything at speed.
        speed_ripple: (largest − least) / mean speed of the crank.
        start_up_s: from rest to speed; inf if the motor cannot.
    """

    mean_power_w: float
    peak_power_w: float
    slide_swing_w: float
    flywheel_swing_w: float
    kinetic_energy_j: float
    speed_ripple: float
    start_up_s: float


def swing_power_w(crank: Crank, mass_kg: float, speed_rad_s: float, angle_rad: FloatArray) -> FloatArray:
    """m x' x'' ω³, (n,): what a slide takes at an even speed."""
    return mass_kg * crank.slope(angle_rad) * crank.curvature(angle_rad) * speed_rad_s**3


def friction_power_w(
    drive: Drive, crank: Crank, mass_kg: float, speed_rad_s: float, angle_rad: FloatArray, gravity_m_s2: float
) -> FloatArray:
    """(n,) what friction takes from one slide."""
    velocity = np.abs(crank.slope(angle_rad)) * speed_rad_s
    rolling = drive.rolling * mass_kg * gravity_m_s2 * velocity
    passing = drive.passing_loss * np.abs(swing_power_w(crank, mass_kg, speed_rad_s, angle_rad))
    return rolling + drive.drag_n_s_m * velocity**2 + passing


def drive_figures(
    drive: Drive, flywheel: Flywheel, speed_rad_s: float, gravity_m_s2: float = 9.80665
) -> DriveFigures:
    """What a mean crank speed takes."""
    crank, ahead = flywheel.crank, _TURN + 0.5 * math.pi
    own = swing_power_w(crank, flywheel.slide_kg, speed_rad_s, _TURN)
    counter = swing_power_w(crank, flywheel.counter_slide_kg, speed_rad_s, ahead)
    friction = friction_power_w(drive, crank, flywheel.slide_kg, speed_rad_s, _TURN, gravity_m_s2)
    if flywheel.counter_slide_kg:
        friction = friction + friction_power_w(
            drive, crank, flywheel.counter_slide_kg, speed_rad_s, ahead, gravity_m_s2
        )
    mean_power = float(friction.mean())
    energy = flywheel.kinetic_energy_j(speed_rad_s)
    margin = drive.motor_power_w - mean_power
    return DriveFigures(
        mean_power_w=mean_power,
        peak_power_w=float(friction.max()),
        slide_swing_w=float(np.abs(own).max()),
        flywheel_swing_w=float(np.abs(own + counter).max()),
        kinetic_energy_j=energy,
        speed_ripple=CrankTurn(flywheel).speed_ripple,
        start_up_s=max(2.0 * energy / margin, speed_rad_s / MAX_START_RAD_S2) if margin > 0 else math.inf,
    )
