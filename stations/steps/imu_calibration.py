"""IMU calibration on a three-axis turntable (paper 1, sections 4.2 and 5.1, in the corrected form).

home → warm up → six positions → ±1080° about each axis → does every axis respond? → coefficients →
into the unit → a second look at what the unit makes of them.
"""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from protocol.gnc_module import SampleStatus, Sensor
from protocol.recordings import Recording
from stations.imu_stand.capture import (
    Capture,
    TurnProfile,
    capture_poses,
    capture_turns,
    stand_of,
)
from stations.imu_stand.session import StandSession, build_session, session_recording
from stations.interruptions import StepError
from stations.recording_store import keep_recording
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step

if TYPE_CHECKING:  # every station knows this step; the evaluation's libraries are loaded when it runs
    from calibration.algorithms.coefficients import TriadCoefficients
    from calibration.imu_session import ImuCalibration

Kind = TypeVar("Kind")

_AXES = "xyz"
_COUPLINGS = ("xy", "xz", "yx", "yz", "zx", "zy")
_TRIADS = ("gyro", "acc")
_POSES, _TURNS, _SESSION, _RECORDING, _CALIBRATION = (
    "imu_poses",
    "imu_turns",
    "imu_session",
    "imu_recording",
    "imu_calibration",
)
_COEFFICIENTS = frozenset(
    f"{triad}_{quantity}"
    for triad in _TRIADS
    for quantity in (
        *(f"scale_factor_error_{axis}" for axis in _AXES),
        *(f"coupling_{pair}" for pair in _COUPLINGS),
        *(f"bias_{axis}" for axis in _AXES),
        "fit_residual_max",
    )
)


@step("imu_home_stand")
def home_stand(ctx: StepContext) -> None:
    """Find the stand's reference, and bring the unit level."""
    stand = stand_of(ctx)
    stand.home()
    stand.move_to((0.0, 0.0, 0.0))


@step("imu_warm_up")
def warm_up(ctx: StepContext) -> None:
    """Let the powered unit warm itself: `duration_s` of bench time."""
    ctx.clock.sleep_until(ctx.clock.now_s() + ctx.number("duration_s"))


@step("imu_six_positions")
def six_positions(ctx: StepContext) -> None:
    """Record raw output with each axis up and down: `duration_s` each, at `rate_hz`."""
    ctx.values[_POSES] = capture_poses(
        ctx,
        duration_s=ctx.number("duration_s"),
        rate_hz=round(ctx.number("rate_hz")),
        compensated=False,
    )


@step("imu_turns")
def turns(ctx: StepContext) -> None:
    """Record raw output while each axis is turned forth and back under the vertical."""
    ctx.values[_TURNS] = capture_turns(
        ctx, _profile(ctx), rate_hz=round(ctx.number("rate_hz")), compensated=False
    )


@step(
    "imu_response",
    measurements=(
        *(f"{triad}_response_{axis}" for triad in _TRIADS for axis in _AXES),
        "gyro_saturated_samples",
        "acc_saturated_samples",
    ),
)
def response(ctx: StepContext) -> None:
    """Keep the recording, and see that every axis is alive and inside its range.

    A response is what the sensor saw of its own turn (or of gravity, up against down), over the truth.
    """
    captures = [*_captures(ctx, _POSES), *_captures(ctx, _TURNS)]
    session = build_session(captures, ctx.site)
    recording = _kept(ctx, session, "imu_calibration")
    ctx.values[_SESSION], ctx.values[_RECORDING] = session, recording
    force = {s.capture.name: s.acc_m_s2.mean(axis=0) for s in session.segments}
    for index, axis in enumerate(_AXES):
        gyro = (session.response[f"{axis}_plus"] + session.response[f"{axis}_minus"]) / 2
        difference = force[f"{axis}_up"][index] - force[f"{axis}_down"][index]
        ctx.measure(f"gyro_response_{axis}", float(gyro))
        ctx.measure(f"acc_response_{axis}", float(difference / (2 * ctx.site.gravity_m_s2)))
    for triad, bit in zip(_TRIADS, (SampleStatus.GYRO_SATURATED, SampleStatus.ACC_SATURATED), strict=True):
        ctx.measure(f"{triad}_saturated_samples", sum(capture.flagged(bit) for capture in captures))


@step("imu_coefficients", measurements=_COEFFICIENTS)
def coefficients(ctx: StepContext) -> None:
    """Coefficients of both triads in y = M u + b, raw: what the manufacturing of the unit gave."""
    from calibration.imu_session import calibrate_imu
    from calibration.sensor_knowledge import sensor_range, slow_noise

    session = _carried(ctx, _SESSION, StandSession)
    recording = _carried(ctx, _RECORDING, Recording)
    found = calibrate_imu(
        session.poses(),
        session.rotations(),
        gyro_range_rad_s=sensor_range(recording, "gyro"),
        acc_range_m_s2=sensor_range(recording, "acc"),
        gyro_slow_noise=slow_noise(recording, "gyro"),
        acc_slow_noise=slow_noise(recording, "acc"),
    )
    ctx.values[_CALIBRATION] = found
    residuals = (found.gyro_residuals_rad_s, found.acc_residuals_m_s2)
    for triad, fitted, left in zip(_TRIADS, (found.gyro, found.acc), residuals, strict=True):
        values = _named(triad, fitted)
        values[f"{triad}_fit_residual_max"] = float(np.abs(np.stack(list(left.values()))).max())
        for name, value in values.items():
            if ctx.declares(name):
                ctx.measure(name, value)
    ctx.message = _uncertainty_words(found, session)


@step("imu_write_coefficients", measurements=("gyro_coefficients_read_back", "acc_coefficients_read_back"))
def write_coefficients(ctx: StepContext) -> None:
    """Write u = K (y − b) into the unit's flash and read it back, bit by bit the same."""
    from calibration.imu_session import ImuCalibration

    found = _carried(ctx, _CALIBRATION, ImuCalibration)
    for triad, sensor, fitted in zip(_TRIADS, Sensor, (found.gyro, found.acc), strict=True):
        ctx.unit.write_coefficients(sensor, fitted.compensation, fitted.bias)
        matrix, bias = ctx.unit.read_coefficients(sensor)
        same = np.array_equal(matrix, fitted.compensation) and np.array_equal(bias, fitted.bias)
        ctx.measure(f"{triad}_coefficients_read_back", same)


@step(
    "imu_second_look",
    measurements=(
        "gyro_scale_factor_error_max",
        "gyro_cross_coupling_max",
        "gyro_bias_residual_max",
        "gyro_angle_residual_max",
        "acc_scale_factor_error_max",
        "acc_cross_coupling_max",
        "acc_bias_residual_max",
        "acc_residual_max",
    ),
)
def second_look(ctx: StepContext) -> None:
    """Record the unit's *compensated* output in new positions' captures and turns: what is left."""
    from calibration.imu_session import verify_imu

    rate_hz = round(ctx.number("rate_hz"))
    poses = capture_poses(ctx, duration_s=ctx.number("duration_s"), rate_hz=rate_hz, compensated=True)
    spins = capture_turns(ctx, _profile(ctx), rate_hz=rate_hz, compensated=True)
    session = build_session([*poses, *spins], ctx.site)
    _kept(ctx, session, "imu_verification")
    for name, (value, _unit) in verify_imu(session.poses(), session.rotations()).as_measurements().items():
        if ctx.declares(name):
            ctx.measure(name, value)


def _named(triad: str, fitted: "TriadCoefficients") -> dict[str, float]:
    scale, coupling = fitted.scale_factor_error(), fitted.cross_coupling()
    values = {f"{triad}_scale_factor_error_{axis}": float(scale[i]) for i, axis in enumerate(_AXES)}
    values |= {f"{triad}_bias_{axis}": float(fitted.bias[i]) for i, axis in enumerate(_AXES)}
    for pair in _COUPLINGS:
        row, column = _AXES.index(pair[0]), _AXES.index(pair[1])
        values[f"{triad}_coupling_{pair}"] = float(coupling[row, column])
    return values


def _uncertainty_words(found: "ImuCalibration", session: StandSession) -> str:
    """Standard uncertainties of this very session, for the record."""
    parts = [
        f"{triad}: u(scale) {fitted.scale_factor_standard_uncertainty().max():.2g}, "
        f"u(coupling) {fitted.cross_coupling_standard_uncertainty().max():.2g} rad, "
        f"u(bias) {fitted.bias_standard_uncertainty().max():.2g} {fitted.unit}"
        for triad, fitted in zip(_TRIADS, (found.gyro, found.acc), strict=True)
    ]
    left_out = "; ".join(f"not used: {item.what}, {item.count} ({item.why})" for item in found.not_used)
    skew = f"unit's clock {1e6 * session.alignment.skew:+.2f} ppm against the bench's"
    return "; ".join([*parts, skew, *([left_out] if left_out else [])])


def _kept(ctx: StepContext, session: StandSession, profile: str) -> Recording:
    """The session as a recording, kept as MCAP and named in the record."""
    lease = ctx.lease
    recording = session_recording(
        session,
        f"{lease.unit.serial}-{profile}-{lease.fence}",
        lease.unit,
        stand_of(ctx).facts(),
        ctx.site,
        {
            "profile": profile,
            "run": lease.attempt_id,
            "mount": f"{lease.station}/{lease.socket}",
            "started_at": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )
    ctx.keep_recording(keep_recording(recording, ctx.recordings_dir, profile))
    return recording


def _profile(ctx: StepContext) -> TurnProfile:
    return TurnProfile(
        angle_deg=ctx.number("angle_deg"),
        duration_s=ctx.number("turn_duration_s"),
        ramp_s=ctx.number("turn_ramp_s"),
        rest_s=ctx.number("rest_s"),
    )


def _captures(ctx: StepContext, name: str) -> list[Capture]:
    return _carried(ctx, name, list)


def _carried(ctx: StepContext, name: str, kind: type[Kind]) -> Kind:
    value = ctx.values.get(name)
    if not isinstance(value, kind):
        raise StepError(
            f"The step needs what '{name}' leaves, and it is not there.",
            remedy="put the steps of the plan into their order.",
        )
    return value
