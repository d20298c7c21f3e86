"""From a recording of one profile to named figures with their standard uncertainties.

    static            bias (and, from an hour on, bias stability)
    rate_staircase    scale factor, non-linearity, asymmetry, bias, misalignment, non-orthogonality
    sweep             gain, delay, lag, bandwidth of each axis that was swept
    tumble            g-sensitivity of the gyros, quadratic term of the accelerometers

Attitude comes from the stand's gimbal angles, body from laboratory = Rx(inner) Ry(middle) Rz(outer),
laboratory z up and y at the azimuth `site.heading_deg`; the Earth rate from them and `site.latitude_deg`.
Without these, or where no trigger joins the clocks, the evaluation is refused: it would be silent about
either.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.axis_geometry import axis_geometry
from calibration.algorithms.bias_figures import STABILITY_DURATION_S, TrueInput, bias, bias_stability
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import earth_rate_ned
from calibration.algorithms.frequency_response import delay_and_lag, frequency_response
from calibration.algorithms.scale_factor_figures import Dwell, find_dwells, staircase_figures
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.tumble_g_sensitivity import (
    Site,
    TumbleRun,
    accelerometer_quadratic,
    gyro_g_sensitivity,
)
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from protocol.errors import CalibrationError, Fault
from protocol.recordings import Recording

CRYSTAL_DOUBT = 20e-6
"""Standard uncertainty of a unit's clock rate: after the trigger the clocks part by so much a second."""
SETTLE_S, LEAST_DWELL_S = 0.2, 0.5
STILL_RAD_S = 1e-5
_XYZ = "xyz"


@dataclass(frozen=True)
class NamedQuantity:
    """One figure. `standard_uncertainty` is of `value`, both in `unit` (SI)."""

    name: str
    value: float
    standard_uncertainty: float
    unit: str


@dataclass(frozen=True)
class ProfileFigures:
    """Figures of one recording, what was said of them, and what they do not rest on."""

    recording_id: str
    profile: str
    quantities: tuple[NamedQuantity, ...]
    words: tuple[str, ...]
    not_used: tuple[NotUsed, ...]

    def __getitem__(self, name: str) -> NamedQuantity:
        """By name."""
        return next(one for one in self.quantities if one.name == name)


def evaluate_profile(recording: Recording) -> ProfileFigures:
    """All figures that the recording's profile carries.

    Raises:
        CalibrationError: another profile, clocks that no trigger joins, no site; or what the figures raise.
    """
    profile = str(recording.test.get("profile", ""))
    if profile not in _EVALUATIONS:
        raise _refused(recording, f"The profile '{profile}' carries no figures here", ", ".join(_EVALUATIONS))
    if not recording.test.get("triggered", True):
        raise _refused(recording, "No trigger joins the clocks of unit and stand", "a triggered recording")
    if "latitude_deg" not in recording.site or "gravity_m_s2" not in recording.site:
        raise _refused(recording, "The site is not stated, so the Earth rate is not known", "its latitude")
    quantities, words, not_used = _EVALUATIONS[profile](recording, _Motion(recording))
    return ProfileFigures(recording.recording_id, profile, tuple(quantities), tuple(words), tuple(not_used))


Found = tuple[list[NamedQuantity], list[str], list[NotUsed]]


class _Motion:
    """What the stand did at the unit's sampling times, in body axes."""

    def __init__(self, recording: Recording) -> None:
        dut, stand = recording.stream("dut"), recording.stream("stand")
        self.time_s, stand_s = dut.time_s(), stand.time_s()

        def at(values: FloatArray) -> FloatArray:
            return np.stack([np.interp(self.time_s, stand_s, one) for one in values.T], axis=1)

        self.rate = at(stand.si("rate_x", "rate_y", "rate_z"))
        angles = at(stand.si("angle_outer", "angle_middle", "angle_inner"))
        heading = math.radians(float(recording.site.get("heading_deg", 0.0)))
        sine, cosine = math.sin(heading), math.cos(heading)
        lab_from_ned = np.array([[-sine, cosine, 0.0], [cosine, sine, 0.0], [0.0, 0.0, -1.0]])
        outer, middle, inner = (_turn(axis, angle) for axis, angle in zip((2, 1, 0), angles.T, strict=True))
        self.dcm_body_from_ned: FloatArray = inner @ middle @ outer @ lab_from_ned
        self.latitude_rad = math.radians(float(recording.site["latitude_deg"]))
        self.earth: FloatArray = self.dcm_body_from_ned @ earth_rate_ned(self.latitude_rad)


def _turn(axis: int, angle: FloatArray) -> FloatArray:
    """(n, 3, 3): coordinates in axes that are turned by the angle about one of them."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, first, first] = turn[:, second, second] = np.cos(angle)
    turn[:, first, second], turn[:, second, first] = np.sin(angle), -np.sin(angle)
    return turn


def _slow(recording: Recording, kind: str) -> tuple[tuple[float, float], ...] | None:
    terms = tuple(
        (one.standard_deviation, one.correlation_time_s)
        for one in slow_noise(recording, kind)
        if math.isfinite(one.correlation_time_s)
    )
    return terms or None


def _static(recording: Recording, motion: _Motion) -> Found:
    output = recording.stream("dut").si(*axes("gyro"))
    still = TrueInput(motion.earth.mean(axis=0), np.zeros(3), "Earth rate in the stand's attitude")
    limit, slow = sensor_range(recording, "gyro"), _slow(recording, "gyro")
    found = bias(motion.time_s, output, still, range_limit=limit, known_slow=slow)
    quantities = _triad("gyro_bias", found.bias, found.standard_uncertainty, "rad/s")
    if motion.time_s[-1] - motion.time_s[0] >= STABILITY_DURATION_S * (1 - 1e-3):
        stable = bias_stability(motion.time_s, output, range_limit=limit, known_slow=slow)
        quantities += _triad("gyro_bias_stability", stable.stability, stable.standard_uncertainty, "rad/s")
    return quantities, [still.words, *found.noise], list(found.not_used)


def _rate_staircase(recording: Recording, motion: _Motion) -> Found:
    output = recording.stream("dut").si(*axes("gyro"))
    found = find_dwells(
        motion.rate, motion.time_s, tolerance_rad_s=STILL_RAD_S, least_s=LEAST_DWELL_S, settle_s=SETTLE_S
    )
    dwells = [
        Dwell(
            f"dwell from {motion.time_s[a]:.1f} s",
            *(motion.time_s[a:b], output[a:b], motion.rate[a:b], motion.earth[a:b]),
        )
        for a, b in found
    ]
    figures = staircase_figures(
        dwells, range_rad_s=sensor_range(recording, "gyro"), known_slow=_slow(recording, "gyro")
    )
    quantities: list[NamedQuantity] = []
    for axis in figures.axes:
        name = _XYZ[axis.axis]
        quantities += [
            NamedQuantity(f"gyro_scale_factor_error_{name}", *axis.scale_factor_error, "1"),
            NamedQuantity(f"gyro_scale_factor_nonlinearity_{name}", *axis.nonlinearity, "1"),
            NamedQuantity(f"gyro_scale_factor_asymmetry_{name}", *axis.asymmetry, "1"),
            NamedQuantity(f"gyro_bias_{name}", *axis.bias_rad_s, "rad/s"),
        ]
    geometry = axis_geometry(figures.coefficients)
    doubt = geometry.standard_uncertainty
    quantities += _triad("gyro_misalignment", geometry.misalignment_rad, doubt[3:6], "rad")
    pairs = zip(("xy", "xz", "yz"), geometry.nonorthogonality_rad, doubt[6:], strict=True)
    quantities += [
        NamedQuantity(f"gyro_nonorthogonality_{pair}", float(value), float(u), "rad")
        for pair, value, u in pairs
    ]
    words = [
        *figures.noise,
        "how the unit sits on the stand is part of the misalignment, not of its uncertainty",
    ]
    return quantities, words, list(figures.not_used)


def _sweep(recording: Recording, motion: _Motion) -> Found:
    dut, stand = recording.stream("dut"), recording.stream("stand")
    stand_s, rates = stand.time_s(), stand.si("rate_x", "rate_y", "rate_z")
    quantities: list[NamedQuantity] = []
    words: list[str] = []
    not_used: list[NotUsed] = []
    for axis, (begin_s, end_s) in _swept(stand_s, rates).items():
        name = _XYZ[axis]
        mine, acted = ((t >= begin_s) & (t <= end_s) for t in (motion.time_s, stand_s))
        response = frequency_response(
            motion.time_s[mine],
            dut.si(f"gyro_{name}")[mine],
            stand_s[acted],
            rates[acted, axis],
            range_limit=sensor_range(recording, "gyro"),
            where=f"sweep about {name}",
        )
        apart_s = CRYSTAL_DOUBT * (begin_s + end_s) / 2.0
        told = delay_and_lag(response, clock_standard_uncertainty_s=apart_s)
        quantities += [
            NamedQuantity(f"gyro_gain_{name}", *told.gain, "1"),
            NamedQuantity(f"gyro_total_delay_{name}", *told.total_delay_s, "s"),
            NamedQuantity(f"gyro_delay_{name}", *told.delay_s, "s"),
            NamedQuantity(f"gyro_time_constant_{name}", *told.time_constant_s, "s"),
        ]
        if told.bandwidth_hz is not None:
            quantities.append(NamedQuantity(f"gyro_bandwidth_{name}", *told.bandwidth_hz, "Hz"))
        words.append(f"{name}: {told.words}")
        not_used += response.not_used
    if not quantities:
        raise _refused(recording, "No axis is swept alone", "a sweep of at least 5 s about one body axis")
    return quantities, words, not_used


def _swept(time_s: FloatArray, rates: FloatArray) -> dict[int, tuple[float, float]]:
    """Axis → begin and end of its longest motion alone, half a second of rest on both sides."""
    found: dict[int, tuple[float, float]] = {}
    for axis in range(3):
        moving = np.abs(rates) > STILL_RAD_S
        alone = np.flatnonzero(moving[:, axis] & ~np.delete(moving, axis, axis=1).any(axis=1))
        if len(alone) == 0:
            continue
        parts = np.split(alone, np.flatnonzero(np.diff(time_s[alone]) > 0.5) + 1)
        longest = max(parts, key=len)
        begin_s, end_s = float(time_s[longest[0]]), float(time_s[longest[-1]])
        if end_s - begin_s >= 5.0:
            found[axis] = (begin_s - 0.5, end_s + 0.5)
    return found


def _tumble(recording: Recording, motion: _Motion) -> Found:
    site = Site(motion.latitude_rad, float(recording.site["gravity_m_s2"]))
    triads = {kind: recording.stream("dut").si(*axes(kind)) for kind in ("gyro", "acc")}
    runs = {
        kind: [TumbleRun(f"tumble ({kind})", motion.time_s, output, motion.rate, motion.dcm_body_from_ned)]
        for kind, output in triads.items()
    }
    gyro = gyro_g_sensitivity(
        runs["gyro"],
        site,
        range_rad_s=sensor_range(recording, "gyro"),
        known_slow=_slow(recording, "gyro"),
    )
    acc = accelerometer_quadratic(
        runs["acc"], site, range_m_s2=sensor_range(recording, "acc"), known_slow=_slow(recording, "acc")
    )
    doubt = gyro.standard_uncertainty()
    quantities = [
        NamedQuantity(
            f"gyro_g_sensitivity_{_XYZ[i]}{_XYZ[j]}",
            *(float(gyro.g_sensitivity[i, j]), float(doubt[i, j])),
            "(rad/s)/(m/s^2)",
        )
        for i in range(3)
        for j in range(3)
    ]
    quantities += _triad(
        "acc_quadratic_nonlinearity",
        acc.quadratic[:, 0],
        acc.quadratic_standard_uncertainty()[:, 0],
        "1/(m/s^2)",
    )
    return quantities, [gyro.words, acc.words], [*gyro.not_used, *acc.not_used]


def _triad(name: str, values: FloatArray, doubt: FloatArray, unit: str) -> list[NamedQuantity]:
    return [
        NamedQuantity(f"{name}_{axis}", float(value), float(u), unit)
        for axis, value, u in zip(_XYZ, values, doubt, strict=True)
    ]


_EVALUATIONS: dict[str, Callable[[Recording, _Motion], Found]] = {
    "static": _static,
    "rate_staircase": _rate_staircase,
    "sweep": _sweep,
    "tumble": _tumble,
}


def _refused(recording: Recording, what: str, needed: str) -> CalibrationError:
    return CalibrationError(
        f"{what}.", where=f"recording {recording.recording_id}", fault=Fault.DATA, remedy=f"record {needed}."
    )
