"""Magnetometer turned all ways in one field: hard and soft iron from the ellipsoid of its outputs."""

# pyright: strict
from dataclasses import replace

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.magnetometer import MagnetometerCoefficients, hard_and_soft_iron
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    believed_sensor,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.records.method_contents import magnetometer_content
from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

HAND_TUMBLE = "hand_tumble"
CHANNELS = ("mag_x", "mag_y", "mag_z")
OTHERS = tuple(f"{kind}_{axis}" for kind in ("acc", "gyro", "volt") for axis in "xyz")
RANGE_MARGIN = 0.002
MAX_SATURATED_PART = 0.2


def magnetometer_alone(recording: Recording) -> bool:
    """Whether three magnetometer channels are all that the unit sent of its sensors."""
    dut = recording.streams.get("dut")
    return dut is not None and dut.has(*CHANNELS) and not any(dut.has(name) for name in OTHERS)


def evaluate_magnetometer(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """K and b of h = K (m - b).

    Raises:
        CalibrationError: no magnetometer, saturated channels, directions that leave an axis out (named),
            points on no ellipsoid, too many outliers.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut", *CHANNELS)
    counts = dut.units[CHANNELS[0]] == "1"
    output = dut.si(*CHANNELS)
    there = np.isfinite(output).all(axis=1)
    saturated = there & (np.abs(output) >= _limit(recording, counts)).any(axis=1)
    used = there & ~saturated
    not_used = [
        NotUsed(say("samples of the magnetometer"), int(count), why)
        for count, why in (
            ((~there).sum(), say("missing (NaN)")),
            (saturated.sum(), say("at the end of the range")),
        )
        if count
    ]
    if saturated.sum() > MAX_SATURATED_PART * max(int(there.sum()), 1):
        raise refused(
            recording,
            f"The magnetometer is at the end of its range in {int(saturated.sum())} of {len(dut)} samples.",
            "turn it in a weaker field, or choose a wider range",
            "stream dut",
        )
    field_t = _field_t(recording)
    unit, field_unit = ("1", "1") if counts else ("T", "1" if field_t is None else "T")
    found = hard_and_soft_iron(output[used], None if counts else field_t)
    if found.outliers:
        not_used.append(
            NotUsed(say("samples of the magnetometer"), found.outliers, say("far from the ellipsoid"))
        )
    result = SensorResult(
        "mag", magnetometer_content(found, unit, field_unit), recordings, _beside(found, output[used], unit)
    )
    evaluation = method_evaluation(recordings, [result], _assumptions(found, field_unit), not_used)
    return replace(evaluation, profile=HAND_TUMBLE)


def _limit(recording: Recording, counts: bool) -> float:
    limit, unit = believed_number(recording, "mag", "range"), believed_sensor(recording, "mag").get("unit")
    if limit is None or not isinstance(unit, str) or (unit == "1") != counts:
        return float("inf")
    return limit * factor_to_si(unit) * (1.0 - RANGE_MARGIN)


def _field_t(recording: Recording) -> float | None:
    """Magnitude of the site's field; None: not stated."""
    stated = recording.site.get("field_uT")
    try:
        magnitude = float(np.linalg.norm(np.array(stated, dtype=np.float64))) * 1e-6
    except (TypeError, ValueError):
        return None
    return magnitude if np.isfinite(magnitude) and magnitude > 0.0 else None


def _assumptions(found: MagnetometerCoefficients, field_unit: str) -> list[str]:
    scale = (
        say("the field's magnitude is not known or the outputs are counts: h is a direction, of magnitude 1")
        if field_unit == "1"
        else say("field of {field} µT as the recording's site says", field=f"{found.field * 1e6:.2f}")
    )
    sentences = [
        scale,
        say("one field of steady magnitude all the while; iron turns with the unit"),
        say("fields that turn with a stand's own axes are uncertain beyond this: use a non-magnetic stand"),
        say("K is symmetric: how the magnetometer sits in its housing, the magnitude does not tell"),
        say("soft iron, scale factors and non-orthogonality of the channels are in K together"),
    ]
    if found.widened > 1.0:
        sentences.append(
            say(
                "residuals stay together in time: uncertainties are {factor} times those of white noise",
                factor=f"{np.sqrt(found.widened):.2g}",
            )
        )
    return sentences


def _beside(found: MagnetometerCoefficients, output: FloatArray, unit: str) -> tuple[Beside, ...]:
    raw = np.linalg.norm(output, axis=1)
    return (
        Beside(say("least radius of the ellipsoid"), float(found.radii[0]), unit),
        Beside(say("middle radius of the ellipsoid"), float(found.radii[1]), unit),
        Beside(say("largest radius of the ellipsoid"), float(found.radii[2]), unit),
        Beside(say("distance from the ellipsoid, rms"), found.distance_rms, unit),
        Beside(say("spread of the magnitude before, relative"), float(raw.std(ddof=1) / raw.mean()), "1"),
        Beside(say("spread of the magnitude after, outliers too"), found.magnitude_spread(output), "1"),
        Beside(say("condition of K"), float(np.linalg.cond(found.compensation)), "1"),
    )
