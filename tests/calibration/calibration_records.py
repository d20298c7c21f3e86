"""Records for tests, and a recording of a unit whose true errors are known."""

from datetime import UTC, datetime
from typing import Any

import numpy as np

from calibration.records.making import TRIAD_NAMES
from calibration.records.record import LINEAR_TRIAD, CalibrationRecord
from calibration.records.record_parts import (
    CalibratedQuantity,
    CodeVersion,
    CovarianceBlock,
    Model,
    SourceRecording,
)
from protocol.recordings import Recording, Stream

MATRIX = np.array([[1.002, -0.003, 0.002], [0.004, 0.998, -0.005], [-0.001, 0.006, 1.004]])
BIAS_M_S2 = np.array([0.2, -0.15, 0.3])


def quantity(name: str, value: float, uncertainty: float | None, unit: str = "1", **more: Any):
    return CalibratedQuantity(name=name, value=value, unit=unit, standard_uncertainty=uncertainty, **more)


def record_of(*quantities: CalibratedQuantity, **changes: Any) -> CalibrationRecord:
    content: dict[str, Any] = {
        "serial": "U-0007",
        "product": "gnc_module",
        "sensor": "acc",
        "method": "imu_calibration",
        "model": Model(name=LINEAR_TRIAD),
        "quantities": quantities or (quantity("bias_x", 0.2, 0.01, "m/s^2"),),
        "recordings": (SourceRecording(recording_id="s-1", sha256="a" * 64, form="mcap"),),
        "code": CodeVersion(package="testloom 0.1.0"),
        "created_at": datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
    }
    return CalibrationRecord(**content | changes)


def with_covariance(values: dict[str, float], matrix: Any, **changes: Any) -> CalibrationRecord:
    """A record of numbers (unit 1) with a covariance block over all of them."""
    rows = tuple(tuple(float(x) for x in row) for row in matrix)
    found = [quantity(name, value, rows[k][k] ** 0.5) for k, (name, value) in enumerate(values.items())]
    return record_of(*found, covariance=(CovarianceBlock(parameters=tuple(values), matrix=rows),), **changes)


def triad_record(bias_unit: str = "m/s^2", factor: float = 1.0, **changes: Any) -> CalibrationRecord:
    """The coefficients of `unit_recording`'s accelerometer; `factor`: m/s^2 in bias units."""
    values = [*MATRIX.ravel(), *(BIAS_M_S2 * factor)]
    units = ["1"] * 9 + [bias_unit] * 3
    found = [
        quantity(name, float(value), 1e-4, unit)
        for name, value, unit in zip(TRIAD_NAMES, values, units, strict=True)
    ]
    return record_of(*found, **changes)


def unit_recording(true_m_s2: Any, temperature_c: Any, **changes: Any) -> Recording:
    """y = M u + b by explicit sums, in g as 64-bit numbers; a gyro beside it."""
    n = len(true_m_s2)
    output = np.zeros((n, 3))
    for i in range(3):
        for j in range(3):
            output[:, i] += MATRIX[i, j] * true_m_s2[:, j]
        output[:, i] += BIAS_M_S2[i]
    units = (
        {"t": "s", "temp": "degC"} | {f"acc_{a}": "g" for a in "xyz"} | {f"gyro_{a}": "rad/s" for a in "xyz"}
    )
    columns = {"t": np.arange(n) * 0.01, "temp": np.asarray(temperature_c, dtype=np.float64)}
    columns |= {f"acc_{a}": output[:, k] / 9.80665 for k, a in enumerate("xyz")}
    columns |= {f"gyro_{a}": np.full(n, 0.25) for a in "xyz"}
    content: dict[str, Any] = {
        "recording_id": "r-1",
        "unit": {"serial": "U-0007", "product": "gnc_module"},
        "test": {"profile": "static"},
        "streams": {"dut": Stream("dut", "dut", "t", units, columns)},
        "believed": {"acc": {"unit": "g", "range": 5, "quantum": 1e-6}},
    }
    return Recording(**content | changes)
