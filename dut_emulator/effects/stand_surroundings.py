# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""What a stand adds besides the errors of its axes: the turning Earth, its motors, its chamber, its crank."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, Triple, parameter
from dut_emulator.effects.recursions import rate_of_change
from dut_emulator.effects.stand import AxisName, axis_angle, axis_waves


@dataclass(frozen=True)
class EarthRate(LinearEffect):
    """The stand's rates are relative to the laboratory, the gyro's to inertial space: y = ω + k Ω, k = 1.

    15.04 °/h (WGS 84: 7.292115e-5 rad/s). Only where the reported rates leave it out.
    """

    share: float = parameter(0.0, "1", (-2.0, 2.0), "share of the Earth rate that the report lacks")
    word: ClassVar[str] = "earth_rate"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Any motion whose attitude is known."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"share": stimulus.triad("earth_rate_rad_s")}


@dataclass(frozen=True)
class MotorField(LinearEffect):
    """A stand's motor turns its field with its axis: y = B + c cos nθ + s sin nθ; 0.1 to 20 µT."""

    cosine_t: Triple = parameter(ZERO, "T", (-1e-3, 1e-3), "field that goes with the cosine")
    sine_t: Triple = parameter(ZERO, "T", (-1e-3, 1e-3), "field that goes with the sine")
    harmonic: float = parameter(1.0, "1", (1.0, 1000.0), "periods in a turn of the axis", held=True)
    axis: AxisName = "inner"
    word: ClassVar[str] = "motor_field"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "A current that does not change with the load."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        sine, cosine = axis_waves(stimulus, self.axis, self.harmonic)
        return {"cosine_t": cosine, "sine_t": sine}


@dataclass(frozen=True)
class ChamberGradient(LinearEffect):
    """The chamber is warmer at its probe than at the unit: T_i = T + g_i (T − T_room); 1 to 5 °C at its ends.

    Acts on what temperature sensors say, one for each axis.
    """

    share: Triple = parameter(ZERO, "1", (-0.5, 0.5), "difference as a share of the distance to room")
    room_c: float = parameter(25.0, "degC", (-40.0, 85.0), "temperature outside the chamber", held=True)
    word: ClassVar[str] = "chamber_gradient"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "A chamber in equilibrium with its walls."
    sensors: ClassVar[tuple[SensorName, ...]] = ("temperature",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"share": samples - self.room_c}


@dataclass(frozen=True)
class CrankGeometry(LinearEffect):
    """A slider-crank is no sinusoid: y = f − λ r θ̇² cos 2θ along the stroke, λ = r / b (first order in λ).

    x = r cos θ + r λ / 4 · cos 2θ: with λ = 0.2, the half-cycle integrals of a² are far from equal (paper 5).
    θ is the inner angle; a scotch yoke has λ = 0.
    """

    ratio: float = parameter(0.0, "1", (0.0, 0.5), "λ = r / b, crank radius over rod length")
    radius_m: float = parameter(0.15, "m", (0.0, 10.0), "crank radius r", held=True)
    stroke: Triple = parameter((1.0, 0.0, 0.0), "1", (-1.0, 1.0), "unit vector, body axes", held=True)
    word: ClassVar[str] = "crank_geometry"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = (
        "A steady speed of the flywheel; terms of λ³ (2 % of the correction at λ = 0.2) are left out."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        rate = rate_of_change(axis_angle(stimulus, "inner"), stimulus, state, "angle")
        _, cosine = axis_waves(stimulus, "inner", 2.0)
        return {"ratio": rate**2 * cosine * (-self.radius_m * np.asarray(self.stroke))}
