"""Which method evaluates which profile.

impact         pure lag of a gyro                                        (paper 3)
eleven_point   line, linearity, hysteresis of analogue gyros             (paper 4)
overload       K_a, K_2 of accelerometers, D of gyros                    (paper 5)
static         noise coefficients, bias, bias stability, repeatability   (IEEE 952, GJB 2426A)
rate_staircase scale factor, linearity, asymmetry, geometry of gyros     (IEEE 952)
sweep          gain, delay, lag, bandwidth of gyros                      (IEEE 528)
tumble         g-sensitivity of gyros, quadratic term of accelerometers  (IEEE 952, 1293)
thermal_positions  sigma(N, T) over a matrix of room temperature         (paper 2)
warm_up            thermal network and cooling scheme                   (paper 2)
temperature_ramp   bias over temperature both ways, hysteresis, dT/dt     (IEEE 952)
hand_tumble    hard and soft iron; so is every recording of a magnetometer alone
spin           zeros, ratio and orthogonality of a magnetometer          (paper 1)
swing          lag and attitude error against a turntable                (paper 2)
flight         errors of roll and pitch by phase, as vehicle_run          (paper 2)
"""

# pyright: strict
from collections.abc import Callable, Sequence
from dataclasses import replace

from calibration.evaluations.eleven_point import evaluate_eleven_point
from calibration.evaluations.flight import evaluate_flight
from calibration.evaluations.impact import evaluate_impact
from calibration.evaluations.magnetometer import HAND_TUMBLE, evaluate_magnetometer, magnetometer_alone
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.evaluations.overload import evaluate_overload
from calibration.evaluations.rate_staircase import evaluate_rate_staircase
from calibration.evaluations.room_matrix import ROOM_PROFILES
from calibration.evaluations.spin import evaluate_spin
from calibration.evaluations.static import evaluate_static
from calibration.evaluations.sweep import evaluate_sweep
from calibration.evaluations.swing import evaluate_swing
from calibration.evaluations.temperature_ramp import evaluate_temperature_ramp
from calibration.evaluations.thermal_positions import evaluate_thermal_positions
from calibration.evaluations.tumble import evaluate_tumble
from calibration.evaluations.warm_up import evaluate_warm_up
from protocol.recordings import Recording

EVALUATIONS: dict[str, Callable[[tuple[Recording, ...]], MethodEvaluation]] = {
    "impact": evaluate_impact,
    "eleven_point": evaluate_eleven_point,
    "overload": evaluate_overload,
    "static": evaluate_static,
    "rate_staircase": evaluate_rate_staircase,
    "sweep": evaluate_sweep,
    "tumble": evaluate_tumble,
    "spin": evaluate_spin,
    "thermal_positions": evaluate_thermal_positions,
    "temperature_ramp": evaluate_temperature_ramp,
    "warm_up": evaluate_warm_up,
    "swing": evaluate_swing,
    "flight": evaluate_flight,
    "vehicle_run": evaluate_flight,
    HAND_TUMBLE: evaluate_magnetometer,
}
TOGETHER = frozenset({"overload", "rate_staircase", "static", "thermal_positions"})
"""Profiles of which one unit's recordings belong together."""
COMPANIONS: dict[str, tuple[str, ...]] = {"thermal_positions": ROOM_PROFILES}
"""Profiles of the same unit that an evaluation takes along where both are named."""


def has_method(recording: Recording) -> bool:
    """Whether the recording's profile has a method of its own here."""
    named = _method_name(recording) in EVALUATIONS
    return (named or magnetometer_alone(recording)) and not recording.test.get("segments")


def profile_of(recording: Recording) -> str:
    """The test profile; empty where none is named."""
    return str(recording.test.get("profile", ""))


def _method_name(recording: Recording) -> str:
    """static_449s and the like, as loggers name their rests, are 'static'."""
    name = profile_of(recording)
    return "static" if name not in EVALUATIONS and name.startswith("static_") else name


def evaluate_by_profile(recordings: Sequence[Recording]) -> MethodEvaluation:
    """Recordings of one unit and one profile, more than one only of those in `TOGETHER`.

    Those of `COMPANIONS` come last.

    Raises:
        CalibrationError: what is missing or cannot be used is named, with a remedy.
    """
    name = _method_name(recordings[0])
    found = EVALUATIONS.get(name, evaluate_magnetometer)(tuple(recordings))
    return replace(found, profile=name) if name in EVALUATIONS else found
