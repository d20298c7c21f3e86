"""Which method evaluates which profile.

impact         pure lag of a gyro                                        (paper 3)
eleven_point   line, linearity, hysteresis of analogue gyros             (paper 4)
overload       K_a, K_2 of accelerometers, D of gyros                    (paper 5)
static         noise coefficients of gyros and accelerometers            (IEEE 952)
spin           zeros, ratio and orthogonality of a magnetometer          (paper 1)
"""

# pyright: strict
from collections.abc import Callable, Sequence

from calibration.evaluations.eleven_point import evaluate_eleven_point
from calibration.evaluations.impact import evaluate_impact
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.evaluations.noise import evaluate_noise
from calibration.evaluations.overload import evaluate_overload
from calibration.evaluations.spin import evaluate_spin
from protocol.recordings import Recording

EVALUATIONS: dict[str, Callable[[tuple[Recording, ...]], MethodEvaluation]] = {
    "impact": evaluate_impact,
    "eleven_point": evaluate_eleven_point,
    "overload": evaluate_overload,
    "static": evaluate_noise,
    "spin": evaluate_spin,
}
TOGETHER = frozenset({"overload"})
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
