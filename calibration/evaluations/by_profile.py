"""Which method evaluates which profile.

impact         pure lag of a gyro                                        (paper 3)
eleven_point   line, linearity, hysteresis of analogue gyros             (paper 4)
overload       K_a, K_2 of accelerometers, D of gyros                    (paper 5)
static         noise coefficients, bias, bias stability, repeatability   (IEEE 952, GJB 2426A)
rate_staircase scale factor, linearity, asymmetry, geometry of gyros     (IEEE 952)
sweep          gain, delay, lag, bandwidth of gyros                      (IEEE 528)
tumble         g-sensitivity of gyros, quadratic term of accelerometers  (IEEE 952, 1293)
spin           zeros, ratio and orthogonality of a magnetometer          (paper 1)
swing          lag and attitude error against a turntable                (paper 2)
flight         errors of roll and pitch by phase, as vehicle_run          (paper 2)
"""

# pyright: strict
from collections.abc import Callable, Sequence

from calibration.evaluations.eleven_point import evaluate_eleven_point
from calibration.evaluations.flight import evaluate_flight
from calibration.evaluations.impact import evaluate_impact
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.evaluations.overload import evaluate_overload
from calibration.evaluations.rate_staircase import evaluate_rate_staircase
from calibration.evaluations.spin import evaluate_spin
from calibration.evaluations.static import evaluate_static
from calibration.evaluations.sweep import evaluate_sweep
from calibration.evaluations.swing import evaluate_swing
from calibration.evaluations.tumble import evaluate_tumble
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
    "swing": evaluate_swing,
    "flight": evaluate_flight,
    "vehicle_run": evaluate_flight,
}
TOGETHER = frozenset({"overload", "rate_staircase", "static"})
"""Profiles of which one unit's recordings belong together."""


def has_method(recording: Recording) -> bool:
    """Whether the recording's profile has a method of its own here."""
    return profile_of(recording) in EVALUATIONS and not recording.test.get("segments")


def profile_of(recording: Recording) -> str:
    """The test profile; empty where none is named."""
    return str(recording.test.get("profile", ""))


def evaluate_by_profile(recordings: Sequence[Recording]) -> MethodEvaluation:
    """Recordings of one unit and one profile, more than one only of those in `TOGETHER`.

    Raises:
        CalibrationError: what is missing or cannot be used is named, with a remedy.
    """
    return EVALUATIONS[profile_of(recordings[0])](tuple(recordings))
