"""Calibrations that were printed as a table in a paper, for public recordings that carry no file of them.

The figures are in `published_tables.json`, each with its source, by the recording's id and its unit's
serial number. They state no uncertainty. What a last digit hides is one: uniform, half of it each way. How
far a fit scatters that rests on some twenty turns by hand is another, evaluated by us where the authors'
code is public: `gyro_scatter`.
"""

import dataclasses
import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from protocol.recordings import Recording

TABLES_FILE = Path(__file__).with_name("published_tables.json")


@dataclass(frozen=True)
class PrintedTriad:
    """y = M u + b as printed, SI, shapes (3, 3) and (3,), with the uncertainty of last digit and scatter."""

    matrix: FloatArray
    matrix_standard_uncertainty: FloatArray
    bias: FloatArray
    bias_standard_uncertainty: FloatArray


@dataclass(frozen=True)
class PrintedTable:
    """Both triads of one unit."""

    source: str
    gravity_m_s2: float
    acc: PrintedTriad
    gyro: PrintedTriad


def table_of(recording: Recording) -> PrintedTable | None:
    """What was printed of this recording's unit; None: nothing is known here."""
    for table in _tables().values():
        unit = table["recordings"].get(recording.recording_id)
        if unit is not None and unit["serial"] == str(recording.unit.get("serial")):
            digit = table["last_digit"]
            return PrintedTable(
                table["source"],
                float(table["gravity_m_s2"]),
                _triad(unit["acc"], digit, digit["acc_bias_m_s2"], 1.0),
                _with_scatter(
                    _triad(unit["gyro"], digit, digit["gyro_bias_deg_s"], math.pi / 180.0),
                    unit["gyro_scatter"],
                ),
            )
    return None


@cache
def _tables() -> dict[str, Any]:
    return json.loads(TABLES_FILE.read_text(encoding="utf-8"))


def _triad(column: list[float], digit: dict[str, float], bias_digit: float, to_si: float) -> PrintedTriad:
    """From s_x s_y s_z (%), m_yz m_xy m_xz (deg), b, and e (deg) where the triad is turned by it."""
    s_x, s_y, s_z = (value / 100.0 for value in column[:3])
    m_yz, m_xy, m_xz = np.radians(column[3:6])
    matrix = np.array([[1.0 + s_x, m_xy, m_xz], [0.0, 1.0 + s_y, m_yz], [0.0, 0.0, 1.0 + s_z]])
    half = 1.0 / math.sqrt(12.0)
    scale, angle = digit["scale_percent"] / 100.0 * half, math.radians(digit["angle_deg"]) * half
    uncertainty = np.triu(np.full((3, 3), angle), 1) + np.diag([scale] * 3)
    bias = np.array(column[6:9]) * to_si
    if len(column) > 9:
        x, y, z = np.radians(column[9:])
        turned = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
        matrix, bias = turned @ matrix, turned @ bias
        # To first order an angle adds to each element off the diagonal.
        uncertainty = np.hypot(uncertainty, angle * (1.0 - np.eye(3)))
    return PrintedTriad(matrix, uncertainty, bias, np.full(3, bias_digit * to_si * half))


def _with_scatter(triad: PrintedTriad, scatter: list[float]) -> PrintedTriad:
    """`scatter`: standard uncertainties of M, row by row, and of b."""
    return dataclasses.replace(
        triad,
        matrix_standard_uncertainty=np.hypot(
            triad.matrix_standard_uncertainty, np.reshape(scatter[:9], (3, 3))
        ),
        bias_standard_uncertainty=np.hypot(triad.bias_standard_uncertainty, scatter[9:]),
    )
