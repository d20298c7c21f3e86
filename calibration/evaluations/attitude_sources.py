"""Attitudes that a recording holds: the unit's own, and ours from its gyros and accelerometers."""

# pyright: strict
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.attitude_angles import quaternion_of_angles
from calibration.algorithms.attitude_uncertainty import AttitudeErrorSources
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.screening import MAX_PERIOD_RATIO, saturated
from calibration.evaluations.method_evaluation import believed_linear, believed_sensor, refused
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import factor_to_si

OWN_ANGLES = ("roll", "pitch", "yaw")
OWN, OURS = "attitude", "strapdown_attitude"
"""Sensors of records: what the unit sends as its attitude, and what its gyros and accelerometers make."""
MAX_CONDITION = 100.0
"""Of a stated matrix: beyond it an axis is dead, or two are one."""
U_SCALE_FACTOR, U_MISALIGNMENT_RAD = 5e-4, 5e-4
"""Standard uncertainties of compensated gyros: what temperature and non-linearity leave."""
U_WARM_UP_RAD_S, WARM_UP_S = math.radians(0.01), 150.0
"""Standard uncertainty of what a gyro's bias does while the unit warms up, and how long that takes."""
WARM_AFTER_S = 600.0
U_ACC_BIAS_M_S2 = 0.01
"""Standard uncertainty of a compensated accelerometer's bias: 1 mg."""
U_PASSED_M_S2 = 0.0980665
"""Standard uncertainty of horizontal accelerations while the gates are open: xi of the gates."""


@dataclass(frozen=True)
class InertialSamples:
    """Rates and specific forces (n, 3) in body axes, compensated where the recording says by what.

    Attributes:
        time_s: (n,).
        broken: (n,) the rate between the sample before and this one is not known: missing, saturated, lost.
        sentence: what was done to them, for people.
    """

    time_s: FloatArray
    rate_rad_s: FloatArray
    force_m_s2: FloatArray
    broken: NDArray[np.bool_]
    sentence: str


def has_own_attitude(dut: Stream) -> bool:
    """Whether the unit sends roll, pitch and yaw."""
    return dut.has(*OWN_ANGLES)


def own_attitude(dut: Stream) -> FloatArray:
    """The unit's own attitude as quaternions (n, 4); rows that it did not send are not numbers."""
    return quaternion_of_angles(dut.si(*OWN_ANGLES))


def has_inertial(dut: Stream) -> bool:
    """Whether the unit sends three gyros and three accelerometers."""
    return dut.has(*axes("gyro"), *axes("acc"))


def inertial_samples(recording: Recording, dut: Stream) -> InertialSamples:
    """What the gyros and accelerometers say.

    Raises:
        CalibrationError: what is stated of a sensor cannot be undone: an axis is dead.
    """
    found: dict[str, FloatArray] = {}
    time_s = dut.time_s()
    broken = np.zeros(len(time_s), dtype=np.bool_)
    stated: list[str] = []
    for kind in ("gyro", "acc"):
        output = dut.si(*axes(kind))
        bad = ~np.isfinite(output).all(axis=1) | saturated(output, sensor_range(recording, kind))
        broken |= bad
        broken[1:] |= bad[:-1]
        if "matrix" in believed_sensor(recording, kind):
            stated.append(kind)
            found[kind] = _compensated(recording, kind, output)
        else:
            found[kind] = output
    steps = np.diff(time_s)
    broken[1:] |= steps > MAX_PERIOD_RATIO * float(np.median(steps))
    sentence = (
        say("gyros and accelerometers compensated by what the recording states of them beforehand")
        if len(stated) == 2
        else say("gyros and accelerometers as the unit sends them: the recording states no coefficients")
    )
    return InertialSamples(time_s, found["gyro"], found["acc"], broken, sentence)


def _compensated(recording: Recording, kind: str, output: FloatArray) -> FloatArray:
    matrix, bias = believed_linear(recording, kind)
    if float(np.linalg.cond(matrix)) > MAX_CONDITION:
        raise refused(
            recording,
            f"What the recording states of the {kind} cannot be undone: its matrix has the condition "
            f"{np.linalg.cond(matrix):.3g}. An axis is dead, or two are one.",
            "calibrate the unit first; one with a dead axis has no attitude",
            f"believed.{kind}.matrix",
        )
    unit = str(believed_sensor(recording, kind).get("unit", ""))
    return (output - bias * factor_to_si(unit)) @ np.linalg.inv(matrix).T


def error_sources(recording: Recording) -> AttitudeErrorSources:
    """Noise as the recording states it, the rest as stated here; a unit just powered on warms up."""
    slow = [term for term in slow_noise(recording, "gyro") if np.isfinite(term.correlation_time_s)]
    deviation = slow[0].standard_deviation if slow else 5e-5
    lasting_s = slow[0].correlation_time_s if slow else 300.0
    powered = recording.test.get("power_on_s", 0.0)
    if not (isinstance(powered, int | float) and powered <= -WARM_AFTER_S):
        deviation, lasting_s = math.hypot(deviation, U_WARM_UP_RAD_S), WARM_UP_S
    return AttitudeErrorSources(
        angle_random_walk_rad_per_sqrt_s=_density(recording, "gyro", "angle_random_walk", 3e-4),
        gyro_bias_instability_rad_s=deviation,
        correlation_time_s=lasting_s,
        gyro_scale_factor=U_SCALE_FACTOR,
        gyro_misalignment_rad=U_MISALIGNMENT_RAD,
        accelerometer_bias_m_s2=U_ACC_BIAS_M_S2,
        velocity_random_walk_m_s_per_sqrt_s=_density(recording, "acc", "velocity_random_walk", 2e-3),
        passed_acceleration_m_s2=U_PASSED_M_S2,
    )


def _density(recording: Recording, kind: str, name: str, otherwise: float) -> float:
    stated = believed_sensor(recording, kind).get(name)
    if not isinstance(stated, Mapping):
        return otherwise
    described = cast(Mapping[str, Any], stated)
    return float(described["value"]) * factor_to_si(str(described["unit"]))
