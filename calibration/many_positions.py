"""Multi-position evaluation of one recording: rests, their means and noise, the fit, what is left over."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import unknown_pose_covariance
from calibration.algorithms.multi_position import PRIOR_NONORTHOGONALITY_RAD, fit_multi_position
from calibration.algorithms.noise_covariance import BLOCKS_PER_REST, Observations, white_density
from calibration.algorithms.screening import MIN_STATIC_SAMPLES, NotUsed, screen_static
from calibration.evaluation import Evaluation, GyroBias, Residual
from calibration.gyros_from_gravity import gyros_from_turned_gravity
from calibration.rest_segments import Segment, rests
from calibration.site_gravity import Gravity
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording

POSE_MEANS_PROFILE = "pose_means"
MAX_POSES = 1000


def evaluate_positions(
    recording: Recording,
    folder: Path | None,
    local: Gravity,
    *,
    acc_range_m_s2: float | None,
) -> Evaluation:
    """Accelerometer from rests of unknown attitude; gyro bias where there is a gyro.

    Args:
        recording: with acc_x, acc_y, acc_z in its stream 'dut'.
        folder: where tables beside the recording are looked for.
        local: gravity at the site.
        acc_range_m_s2: end of the accelerometer's range; None: not known.

    Raises:
        CalibrationError: too few rests, or attitudes that leave a scale factor or a bias open.
    """
    stream = recording.stream("dut")
    acc = stream.si("acc_x", "acc_y", "acc_z")
    not_used: list[NotUsed] = []
    rows, source = _poses(recording, folder, acc, acc_range_m_s2, not_used)
    if len(rows) > MAX_POSES:
        raise CalibrationError(
            f"{len(rows)} poses are more than {MAX_POSES}.",
            where=recording.recording_id,
            fault=Fault.DATA,
            remedy="evaluate the recording in parts.",
        )
    means = np.array([acc[index].mean(axis=0) for _, index in rows]).reshape(-1, 3)
    variance = _mean_variance(rows, acc, means)
    fit = fit_multi_position(means, variance, local.magnitude_m_s2, f"recording {recording.recording_id}")
    gyro_bias, turned = None, None
    if stream.has("gyro_x", "gyro_y", "gyro_z"):
        gyro_bias = _gyro_bias(rows, stream.si("gyro_x", "gyro_y", "gyro_z"))
    if gyro_bias is not None:
        gravity = local.magnitude_m_s2
        turned = gyros_from_turned_gravity(recording, rows, fit.coefficients, gyro_bias, gravity, not_used)
    return Evaluation(
        recording_ids=(recording.recording_id,),
        serial=str(recording.unit.get("serial", "")),
        product=str(recording.unit.get("product", "")),
        method="multi_position",
        acc=fit.coefficients.with_input_uncertainty(local.relative_uncertainty),
        gyro=None if turned is None else turned.fit.coefficients,
        gyro_bias=gyro_bias if turned is None else None,
        residuals=(
            *(
                Residual(name, (float(value),), "m/s^2")
                for (name, _), value in zip(rows, fit.norm_residuals_m_s2, strict=True)
            ),
            *(() if turned is None else turned.residuals),
        ),
        assumptions=(
            local.sentence,
            *_sentences(source, len(rows), fit.between_rests_m_s2, fit.assumed),
            *(() if turned is None else turned.sentences),
        ),
        not_used=tuple(not_used),
    )


def _poses(
    recording: Recording,
    folder: Path | None,
    acc: FloatArray,
    acc_range_m_s2: float | None,
    not_used: list[NotUsed],
) -> tuple[list[tuple[str, NDArray[np.intp]]], str]:
    """Name and usable rows of each pose, and in words how they were found."""
    if recording.test.get("profile") == POSE_MEANS_PROFILE:
        kept = np.flatnonzero(np.isfinite(acc).all(axis=1))
        if len(kept) < len(acc):
            not_used.append(NotUsed(say("rows"), len(acc) - len(kept), "missing values (NaN)"))
        return [(f"row {k + 1}", np.array([k])) for k in kept.tolist()], say(
            "each row is the mean of one pose"
        )
    segmentation = rests(recording, folder)
    rows = _usable_rows(
        segmentation.segments, recording.stream("dut").time_s(), acc, acc_range_m_s2, not_used
    )
    inside = sum(segment.last - segment.first for segment in segmentation.segments)
    if inside < len(acc):
        not_used.append(
            NotUsed(say("between the rests"), len(acc) - inside, say("motion without a reference"))
        )
    return rows, segmentation.source


def _sentences(source: str, poses: int, between_m_s2: float, assumed: tuple[str, ...]) -> list[str]:
    sentences = [
        say("{count} poses: {source}", count=poses, source=source),
        say("body axes: z along the input axis of z, y in the plane of the input axes of y and z"),
    ]
    if between_m_s2 > 0.0:
        sentences.append(
            say(
                "poses scatter by {scatter} m/s² beyond their own noise: it is in the uncertainties",
                scatter=f"{between_m_s2:.2g}",
            )
        )
    for name in assumed:
        sentences.append(
            say(
                "these attitudes leave the non-orthogonality {axes} open: taken as 0 ± {prior} rad (stated)",
                axes=name[2:],
                prior=f"{PRIOR_NONORTHOGONALITY_RAD:g}",
            )
        )
    return sentences


def _usable_rows(
    segments: tuple[Segment, ...],
    time_s: FloatArray,
    acc: FloatArray,
    limit: float | None,
    not_used: list[NotUsed],
) -> list[tuple[str, NDArray[np.intp]]]:
    """Rows of each rest that can be used. A rest may be a few samples long: its weight says so."""
    rows: list[tuple[str, NDArray[np.intp]]] = []
    for segment in segments:
        inside = slice(segment.first, segment.last)
        usable, left_out = screen_static(
            segment.name, acc[inside], limit, min_samples=1, time_s=time_s[inside]
        )
        not_used.extend(left_out)
        if len(usable):
            rows.append((segment.name, usable + segment.first))
    return rows


def _mean_variance(
    rows: list[tuple[str, NDArray[np.intp]]], acc: FloatArray, means: FloatArray
) -> FloatArray:
    """Variance of each rest's norm from the white noise inside the rests, shape (n,), (m/s^2)^2.

    Counted in samples, not in seconds: no rate is needed, and none is claimed.
    """
    parts = [
        (k, part)
        for k, (_, index) in enumerate(rows)
        if len(index) >= MIN_STATIC_SAMPLES
        for part in np.array_split(index, BLOCKS_PER_REST)
    ]
    if not parts:
        return np.zeros(len(rows))
    runs = np.array([k for k, _ in parts], dtype=np.intp)
    observations = Observations(
        true_input=means[runs],
        output=np.array([acc[part].mean(axis=0) for _, part in parts]),
        middle_s=np.array([float(part.mean()) for _, part in parts]),
        duration_s=np.array([float(len(part)) for _, part in parts]),
        run=runs,
        run_names=tuple(name for name, _ in rows),
        reference_covariance=np.zeros((len(rows), 3, 3)),
    )
    direction = means / np.linalg.norm(means, axis=1, keepdims=True)
    counts = np.array([len(index) for _, index in rows])
    return (direction**2 @ white_density(observations)) / counts


def _gyro_bias(rows: list[tuple[str, NDArray[np.intp]]], gyro: FloatArray) -> GyroBias | None:
    """Mean of the rests' means; uncertainty from their scatter, so slow changes are not averaged away."""
    rest_means = np.array([gyro[index].mean(axis=0) for _, index in rows if len(index) >= MIN_STATIC_SAMPLES])
    rest_means = rest_means[np.isfinite(rest_means).all(axis=1)] if len(rest_means) else rest_means
    if len(rest_means) < 4:
        return None
    freedom = len(rest_means) - 1
    scatter = rest_means.std(axis=0, ddof=1) / np.sqrt(len(rest_means))
    # Variance of the t distribution (JCGM 101:2008, 6.4.9.2), and Earth rate from an unknown direction.
    variance = scatter**2 * freedom / (freedom - 2) + np.diag(unknown_pose_covariance())
    return GyroBias(rest_means.mean(axis=0), np.sqrt(variance), freedom)
