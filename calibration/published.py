"""Published calibrations that lie beside public recordings, and how an evaluation compares with them.

Read are imucal's JSON (K, R, b of a Ferraris calibration, in counts), the plain columns of ImuCalibration
(params_acc.csv, params_gyro.csv, after Tedaldi et al.) and of MagnetometerCalibration (paramters_mag.csv),
and tables that were only printed, `published_tables`. A published figure states no uncertainty and rests
on the same data. The normalised error uses ours and what the published one's method is worth on these data,
where that is known: last digit, scatter of a fit (`published_tables`), bias of a plain ellipsoid.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.plain_ellipsoid import UPPER, plain_ellipsoid_doubt
from calibration.evaluation import Evaluation
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.gyros_from_gravity import TURNS_LOST
from calibration.published_tables import PrintedTable, table_of
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

IMUCAL_PREFIX = "published_calibration"
PARAMETERS_ACC = "params_acc.csv"
PARAMETERS_GYRO = "params_gyro.csv"
PARAMETERS_MAG = "paramters_mag.csv"
MAX_REFERENCE_BYTES = 1_000_000
IMUCAL_GRAVITY = "9.81"


@dataclass(frozen=True)
class Comparison:
    """One figure beside its published value.

    `normalised_error`: difference over the standard uncertainty. `percent`: difference over the
    published value; None where that says nothing (biases, small angles).
    """

    name: str
    value: float
    published: float
    standard_uncertainty: float
    unit: str
    percent: float | None
    published_standard_uncertainty: float = 0.0

    @property
    def difference(self) -> float:
        return self.value - self.published

    @property
    def normalised_error(self) -> float:
        uncertainty = math.hypot(self.standard_uncertainty, self.published_standard_uncertainty)
        if uncertainty > 0:
            return self.difference / uncertainty
        return math.copysign(math.inf, self.difference) if self.difference else 0.0


@dataclass(frozen=True)
class ComparedReference:
    """All figures of one published calibration, and remarks for people."""

    source: str
    comparisons: tuple[Comparison, ...]
    remarks: tuple[str, ...]


def compare_with_published(
    evaluation: Evaluation, recording: Recording, folder: Path | None
) -> ComparedReference | None:
    """The published calibration beside a recording, compared; None where there is none for it.

    Raises:
        CalibrationError: the file is damaged, or the recording lacks the quantum that its counts need.
    """
    printed = table_of(recording) if evaluation.method == "multi_position" else None
    if printed is not None:
        return _compare_table(evaluation, printed)
    if folder is None:
        return None
    for place in (folder, folder.parent):
        if evaluation.method == "ferraris":
            for path in sorted(place.glob(f"{IMUCAL_PREFIX}*.json")):
                # published_calibration_<word>.json is of the recordings named <word>-…
                word = path.stem.removeprefix(IMUCAL_PREFIX).strip("_")
                if recording.recording_id.startswith(word):
                    return _compare_imucal(evaluation, recording, path)
        elif evaluation.method == "multi_position" and recording.test.get("profile") == "multi_position":
            path = place / PARAMETERS_ACC
            if path.is_file():
                return _compare_columns(evaluation, recording, path)
    return None


def compare_magnetometer(evaluation: MethodEvaluation, folder: Path | None) -> ComparedReference | None:
    """The published matrix of a magnetometer beside its recording, compared; None where there is none.

    Published h = A m + a, |h| = 1, leaves a rotation open: K is the symmetric root of A^T A, b = -inv(A) a.

    Raises:
        CalibrationError: the file is damaged.
    """
    (result, *_) = evaluation.results
    places = () if folder is None else (folder, folder.parent)
    path = next((place / PARAMETERS_MAG for place in places if (place / PARAMETERS_MAG).is_file()), None)
    if path is None or result.content.model.name != "ellipsoid":
        return None
    column = _column(path, 12)
    matrix = column[:9].reshape(3, 3)
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    if float(values[0]) <= 0.0:
        raise _damaged(path, "its matrix cannot be inverted")
    root = (vectors * np.sqrt(values)) @ vectors.T
    centre = -np.linalg.solve(matrix, column[9:])
    published = {f"soft_iron_compensation_{'xyz'[i]}{'xyz'[j]}": float(root[i, j]) for i, j in UPPER} | {
        f"hard_iron_{'xyz'[i]}": float(centre[i]) for i in range(3)
    }
    ours = {one.name: one for one in result.content.quantities if one.name in published}
    here = np.array([ours[name].value for name in published])
    matrix_here = np.zeros((3, 3))
    for (i, j), element in zip(UPPER, here[:6], strict=True):
        matrix_here[i, j] = matrix_here[j, i] = element
    output = result.recordings[0].stream("dut").si("mag_x", "mag_y", "mag_z")
    doubt = plain_ellipsoid_doubt(output[np.isfinite(output).all(axis=1)], matrix_here, here[6:])
    comparisons = tuple(
        Comparison(
            f"mag {ours[name].symbol}",
            ours[name].value,
            reference,
            ours[name].standard_uncertainty or 0.0,
            ours[name].unit,
            100 * (ours[name].value / reference - 1) if name[-2:] in ("xx", "yy", "zz") else None,
            float(of_plain),
        )
        for (name, reference), of_plain in zip(published.items(), doubt, strict=True)
    )
    remarks = (
        say(
            "a fit that does not allow for noise takes short axes for longer: the published figures' "
            "uncertainty is the bias of such a fit on points simulated from the figures here, and its "
            "scatter over stretches of this recording"
        ),
    )
    return ComparedReference(path.name, comparisons, remarks)


def _compare_table(evaluation: Evaluation, printed: PrintedTable) -> ComparedReference:
    comparisons: list[Comparison] = []
    remarks = [
        say(
            "the published calibration takes gravity as {gravity} m/s²", gravity=f"{printed.gravity_m_s2:.2f}"
        )
    ]
    for kind, coefficients, published in (
        ("acc", evaluation.acc, printed.acc),
        ("gyro", evaluation.gyro, printed.gyro),
    ):
        if coefficients is None:
            continue
        uncertainty, bias_uncertainty = (
            coefficients.matrix_standard_uncertainty(),
            coefficients.bias_standard_uncertainty(),
        )
        for i, j in ((i, j) for i in range(3) for j in range(3)):
            if uncertainty[i, j] == 0.0 and published.matrix_standard_uncertainty[i, j] == 0.0:
                continue  # 0 by the choice of axes, in both
            value, reference = float(coefficients.matrix[i, j]), float(published.matrix[i, j])
            comparisons.append(
                Comparison(
                    f"{kind} m_{'xyz'[i]}{'xyz'[j]}",
                    value,
                    reference,
                    float(uncertainty[i, j]),
                    "1",
                    100 * (value / reference - 1) if i == j else None,
                    float(published.matrix_standard_uncertainty[i, j]),
                )
            )
        unit = coefficients.unit
        for i in range(3):
            comparisons.append(
                Comparison(
                    f"{kind} b_{'xyz'[i]}",
                    float(coefficients.bias[i]),
                    float(published.bias[i]),
                    float(bias_uncertainty[i]),
                    unit,
                    None,
                    float(published.bias_standard_uncertainty[i]),
                )
            )
    if evaluation.gyro is not None:
        remarks.append(
            say(
                "the published gyro figures' uncertainty is evaluated here: by the authors' code on these "
                "recordings, as its scatter when one turn after another is left out"
            )
        )
    return ComparedReference(printed.source, tuple(comparisons), tuple(remarks))


def _compare_imucal(evaluation: Evaluation, recording: Recording, path: Path) -> ComparedReference:
    """imucal: u = R^-1 K^-1 (counts - b), so that M = K R counts per m/s^2 or deg/s."""
    document = _json(path)
    comparisons: list[Comparison] = []
    remarks = [say("the published calibration takes gravity as {gravity} m/s²", gravity=IMUCAL_GRAVITY)]
    for kind, letter, coefficients in (("acc", "a", evaluation.acc), ("gyro", "g", evaluation.gyro)):
        if coefficients is None:
            continue
        count_si = _quantum(recording, kind, path)
        unit_name = "m/s^2" if kind == "acc" else "deg/s"
        scale = _array(document, f"K_{letter}", (3, 3), path)
        matrix = scale @ _array(document, f"R_{letter}", (3, 3), path) * (count_si / factor_to_si(unit_name))
        bias = _array(document, f"b_{letter}", (3,), path) * count_si
        if np.trace(matrix) * np.trace(coefficients.matrix) < 0:
            matrix = -matrix
            remarks.append(
                say(
                    "the published {kind} matrix has the opposite sign: it assumes turns the other way round",
                    kind=kind,
                )
            )
        comparisons += _scale_factors(kind, coefficients, np.linalg.norm(matrix, axis=1))
        comparisons += _biases(kind, coefficients.bias, coefficients.bias_standard_uncertainty(), bias)
        comparisons += _cross_couplings(kind, coefficients, matrix)
    return ComparedReference(path.name, tuple(comparisons), tuple(remarks))


def _compare_columns(evaluation: Evaluation, recording: Recording, path: Path) -> ComparedReference:
    """ImuCalibration: a = T K (counts + b): 3 misalignments, 3 scales (m/s^2 per count), 3 biases to add."""
    comparisons: list[Comparison] = []
    remarks: list[str] = []
    if evaluation.acc is not None:
        column = _column(path, 9)
        count_si = _quantum(recording, "acc", path)
        compensation = np.diag(evaluation.acc.compensation)
        uncertainty = np.diag(evaluation.acc.compensation_standard_uncertainty())
        for axis in range(3):
            published = float(column[3 + axis]) / count_si
            comparisons.append(
                Comparison(
                    f"acc k_{'xyz'[axis] * 2}",
                    float(compensation[axis]),
                    published,
                    float(uncertainty[axis]),
                    "1",
                    100 * (float(compensation[axis]) / published - 1),
                )
            )
        bias_uncertainty = evaluation.acc.bias_standard_uncertainty()
        comparisons += _biases("acc", evaluation.acc.bias, bias_uncertainty, -column[6:] * count_si)
    gyro_path = path.with_name(PARAMETERS_GYRO)
    if evaluation.gyro_bias is not None and gyro_path.is_file():
        # The gyro's biases are of its static records and to be taken away: 6 misalignments, 3 scales before.
        published_bias = _column(gyro_path, 12)[9:] * _quantum(recording, "gyro", gyro_path)
        gyro = evaluation.gyro_bias
        comparisons += _biases("gyro", gyro.bias_rad_s, gyro.standard_uncertainty_rad_s, published_bias)
        if gyro_matrix_lost(evaluation):
            remarks.append(
                say(
                    "the published gyro scale factors rest on turns in which gyros were at the end of their "
                    "range: nothing here to compare them with"
                )
            )
    return ComparedReference(path.name, tuple(comparisons), tuple(remarks))


def gyro_matrix_lost(evaluation: Evaluation) -> bool:
    """Whether turns were left out because a gyro was at the end of its range, and no matrix was found."""
    return evaluation.gyro is None and any(TURNS_LOST in one.why for one in evaluation.not_used)


def _scale_factors(kind: str, coefficients: TriadCoefficients, published: FloatArray) -> list[Comparison]:
    values = np.linalg.norm(coefficients.matrix, axis=1)
    uncertainties = coefficients.scale_factor_standard_uncertainty()
    return [
        Comparison(
            f"{kind} scale factor {axis}",
            float(value),
            float(reference),
            float(uncertainty),
            "1",
            100 * float(value / reference - 1),
        )
        for axis, value, reference, uncertainty in zip("xyz", values, published, uncertainties, strict=True)
    ]


def _biases(kind: str, bias: FloatArray, uncertainty: FloatArray, published: FloatArray) -> list[Comparison]:
    unit = "m/s^2" if kind == "acc" else "rad/s"
    return [
        Comparison(f"{kind} b_{axis}", float(value), float(reference), float(u), unit, None)
        for axis, value, reference, u in zip("xyz", bias, published, uncertainty, strict=True)
    ]


def _cross_couplings(kind: str, coefficients: TriadCoefficients, published: FloatArray) -> list[Comparison]:
    uncertainty = coefficients.matrix_standard_uncertainty()
    return [
        Comparison(
            f"{kind} m_{'xyz'[i]}{'xyz'[j]}",
            float(coefficients.matrix[i, j]),
            float(published[i, j]),
            float(uncertainty[i, j]),
            "1",
            None,
        )
        for i in range(3)
        for j in range(3)
        if i != j
    ]


def _quantum(recording: Recording, kind: str, path: Path) -> float:
    """SI value of one count of the sensor's output."""
    described = recording.believed.get(kind)
    if isinstance(described, Mapping) and isinstance(described.get("quantum"), int | float):
        return float(described["quantum"]) * factor_to_si(str(described["unit"]))
    raise _damaged(path, f"the recording does not say how large a count of its {kind} is")


def _json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise _damaged(path, f"it is not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise _damaged(path, "it is not a JSON object")
    return document


def _array(document: Mapping[str, Any], key: str, shape: tuple[int, ...], path: Path) -> FloatArray:
    try:
        array = np.array(document[key], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        raise _damaged(path, f"it has no numeric '{key}'") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise _damaged(path, f"'{key}' is not a finite array of shape {shape}")
    return array


def _column(path: Path, count: int) -> FloatArray:
    try:
        column = np.array([float(line) for line in _text(path).split()], dtype=np.float64)
    except ValueError:
        raise _damaged(path, "it holds something that is not a number") from None
    if column.shape != (count,) or not np.isfinite(column).all():
        raise _damaged(path, f"it does not hold {count} finite numbers")
    return column


def _text(path: Path) -> str:
    if path.stat().st_size > MAX_REFERENCE_BYTES:
        raise _damaged(path, f"it is larger than {MAX_REFERENCE_BYTES} bytes")
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise _damaged(path, f"it cannot be read: {error}") from None


def _damaged(path: Path, what: str) -> CalibrationError:
    return CalibrationError(
        f"The published calibration {path.name} cannot be compared: {what}.",
        where=str(path),
        fault=Fault.DATA,
        remedy="correct the file, or take it away from beside the recording.",
    )
