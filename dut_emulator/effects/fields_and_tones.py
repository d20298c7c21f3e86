# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""Magnetic effects, tones that alias, and the antenna's lever arm."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, ZERO_MATRIX, Matrix, Triple, parameter


@dataclass(frozen=True)
class HardIron(LinearEffect):
    """Magnetised parts that turn with the unit add a field: y = B + h; 1 to 50 µT.

    Paper 1 calibrates it on the non-magnetic turntable, as the centre of the ellipse.
    """

    field_t: Triple = parameter(ZERO, "T", (-1e-3, 1e-3), "field of the unit itself")
    word: ClassVar[str] = "hard_iron"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "The unit is not magnetised anew."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"field_t": np.ones((len(samples), 1))}


@dataclass(frozen=True)
class SoftIron(LinearEffect):
    """Permeable parts bend the field: y_i = B_i + Σ_j s_ij B_j; 1 to 10 %.

    The matrix includes the scale factors; its symmetric part makes a sphere of fields an ellipsoid.
    """

    matrix: Matrix = parameter(ZERO_MATRIX, "1", (-0.9, 0.9), "sensor i for field along axis j")
    word: ClassVar[str] = "soft_iron"
    stage: ClassVar[Stage] = Stage.MOUNTING
    valid: ClassVar[str] = "Fields of the order of the Earth's; no hysteresis of the iron."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"matrix": samples}


@dataclass(frozen=True)
class CurrentCoupling(LinearEffect):
    """Currents on the board make a field: y = B + c I; 1 A at 5 cm makes 4 µT."""

    per_ampere_t: Triple = parameter(ZERO, "T per A", (-1e-3, 1e-3), "field per ampere of supply current")
    word: ClassVar[str] = "current_coupling"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "One path of the current."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"per_ampere_t": stimulus.channel("supply_current_a")[:, np.newaxis]}


@dataclass(frozen=True)
class Tone(LinearEffect):
    """The base of a sine of one frequency: y = u + c cos 2πft + s sin 2πft, t the sampling instant.

    Sampled as it is, it appears at its alias |f − k f_s|.
    """

    cosine_si: Triple = parameter(ZERO, "{si}", (-0.1, 0.1), "amplitude of the cosine")
    sine_si: Triple = parameter(ZERO, "{si}", (-0.1, 0.1), "amplitude of the sine")
    frequency_hz: float = parameter(50.0, "Hz", (0.0, 1e6), "frequency", held=True)
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        sine, cosine = stimulus.tone(self.frequency_hz)
        return {"cosine_si": cosine[:, np.newaxis], "sine_si": sine[:, np.newaxis]}


@dataclass(frozen=True)
class MainsInterference(Tone):
    """The field of mains wiring: y = B + c cos 2πft + s sin 2πft, f 50 Hz (60 Hz where the mains have it).

    A sampled magnetometer shows it at its alias |f − k f_s|.
    """

    word: ClassVar[str] = "mains_interference"
    valid: ClassVar[str] = "A steady mains frequency; harmonics are not part of it."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)


@dataclass(frozen=True)
class Aliasing(Tone):
    """A vibration beyond half the sampling rate folds down: y = u + c cos 2πft + s sin 2πft.

    What is seen at the sampling instants t has the frequency |f − k f_s| (C. E. Shannon, *Communication in
    the Presence of Noise*, 1949).
    """

    frequency_hz: float = parameter(1010.0, "Hz", (0.0, 1e6), "true frequency", held=True)
    word: ClassVar[str] = "aliasing"
    stage: ClassVar[Stage] = Stage.TRANSPORT
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "One steady vibration; no filter before the sampler."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc", "mag")


@dataclass(frozen=True)
class AntennaLeverArm(LinearEffect):
    """The antenna is not where the unit is: y = p + C r, r from the unit to the antenna in body axes.

    (P. D. Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, lever arm.)
    """

    arm_m: Triple = parameter(ZERO, "m", (-100.0, 100.0), "from the unit to the antenna, body axes")
    word: ClassVar[str] = "antenna_lever_arm"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "gnss"
    valid: ClassVar[str] = "A rigid arm."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gnss",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"arm_m": np.moveaxis(stimulus.channel("dcm_local_from_body"), 2, 0)}
