"""Each method of the papers as a record: figures of the papers' oracles, budgets that add up, round trip."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.magnetometer import hard_and_soft_iron
from calibration.algorithms.overload_g_sensitivity import GSensitivity
from calibration.algorithms.pure_lag import PureLag
from calibration.algorithms.rate_gyro import evaluate_rate_gyro
from calibration.algorithms.sinusoidal_overload import KnownAccelerometer, calibrate_overload
from calibration.algorithms.temperature_compensation import fit_temperature
from calibration.records.applying import apply_record
from calibration.records.making import Origin, RecordContent, record_of
from calibration.records.method_contents import (
    allan_content,
    g_sensitivity_content,
    magnetometer_content,
    overload_content,
    pure_lag_content,
    rate_gyro_content,
)
from calibration.records.record import CalibrationRecord, parse_record
from calibration.records.record_parts import CodeVersion, SourceRecording, TemperatureSpan
from calibration.records.temperature_contents import temperature_content
from protocol.errors import CalibrationError
from protocol.recordings import Recording, Stream
from tests.calibration.test_magnetometer import COMPENSATION, HARD_IRON, _turned
from tests.calibration.test_rate_gyro import FIT, METER, PAPER_RUNS, TABLE
from tests.calibration.test_sinusoidal_overload import KNOWN, TRUTH, G, in_g, pulses_of, sinusoid
from tests.calibration.test_temperature_compensation import NODES, POSES, ROOM, ROOM_C, VECTORS, emulated, run

RECORDING = Recording("r-1", {"serial": "U-1", "product": "any"}, {"profile": "any"}, {})


def recorded(content: RecordContent, sensor: str = "gyro") -> CalibrationRecord:
    """Through its bytes."""
    source = SourceRecording(recording_id="r-1", sha256="0" * 64, form="mcap")
    origin = Origin((source,), CodeVersion(package="testloom 0"), datetime(2026, 1, 1, tzinfo=UTC))
    made = record_of(content, sensor, [RECORDING], origin)
    read = parse_record(made.canonical_json(), "x")
    assert read == made
    for budget in read.budgets:  # a budget and its quantity say the same
        assert budget.standard_uncertainty == pytest.approx(read.quantity(budget.result).standard_uncertainty)
    return read


def test_paper_4s_line() -> None:
    record = recorded(rate_gyro_content(PAPER_RUNS, evaluate_rate_gyro(PAPER_RUNS), TABLE, METER))
    expected, slope = FIT["least_squares"], record.quantity("scale_factor")
    assert slope.unit == "V/(rad/s)"
    assert math.radians(slope.value) == pytest.approx(expected["K"], abs=6e-10)
    # u(K): the oracle's scatter with the bounds of table (1e-4) and meter (3.5e-5) over sqrt 3
    parts = (expected["uK"], expected["K"] * 1e-4 / 3**0.5, expected["K"] * 3.5e-5 / 3**0.5)
    assert math.radians(slope.standard_uncertainty or 0) == pytest.approx(math.hypot(*parts), rel=1e-6)
    bias = record.quantity("bias")
    assert bias.value == pytest.approx(expected["Y0"] - math.degrees(expected["K"]) * 4e-5, abs=1e-9)
    assert record.quantity("scale_factor_nonlinearity").value == pytest.approx(
        expected["linearity"], abs=6e-10
    )
    assert [budget.result for budget in record.budgets] == [
        "scale_factor",
        "bias",
        "scale_factor_nonlinearity",
    ]
    assert len(record.tables[0].columns[0].values) == 11


def test_paper_3s_lag_has_its_bounds() -> None:
    lag = recorded(pure_lag_content(PureLag(245.19e-6, 239.27e-6, 242.23e-6, 2.96e-6, 2.96e-6 / 3**0.5, 31)))
    (found,) = lag.quantities
    assert found.interval is not None
    assert found.interval.upper - found.interval.lower == pytest.approx(5.92e-6)
    # the middle 95.45 % of an even distribution
    assert found.expanded_uncertainty == pytest.approx(0.9545 * 2.96e-6)


def test_paper_5s_coefficients_and_what_they_hang_on() -> None:
    motion = sinusoid(10.0, cycles=6)
    known = KnownAccelerometer(KNOWN.scale_factor_pulse_s_m, KNOWN.bias_m_s2, 1e-4, 1e-3 * G, 1e-5)
    record = recorded(overload_content(calibrate_overload(motion, pulses_of(motion), known)), "acc_x")
    pair = [record.quantity(name).value for name in ("scale_factor_asymmetry", "odd_quadratic_nonlinearity")]
    np.testing.assert_allclose(in_g(pair), TRUTH, rtol=1e-6)
    (of_bias,) = [row for row in record.budgets[0].rows if row.quantity == "bias K_0"]
    assert abs(of_bias.contribution) == pytest.approx(1.6e-4, rel=0.02)  # paper 5: 1 mg at 10 g
    (of_scale,) = [row for row in record.budgets[1].rows if row.quantity == "scale factor K_1"]
    assert abs(of_scale.contribution) * G == pytest.approx(1.27e-5, rel=0.01)  # 100 ppm at 10 g, per g

    matrix = np.arange(9.0).reshape(3, 3)
    of_rows = np.array([np.diag([1.0, 4.0, 9.0])] * 3)
    found = recorded(g_sensitivity_content(GSensitivity(matrix, of_rows, np.zeros((1, 3)), matrix)))
    assert found.quantity("g_sensitivity_yz").value == 5.0
    assert found.quantity("g_sensitivity_yz").standard_uncertainty == 3.0


def test_noise_coefficients_and_those_that_are_absent() -> None:
    rate_hz, density = 100.0, 2e-4
    white = density * math.sqrt(rate_hz) * np.random.default_rng(4).standard_normal(40_000)
    record = recorded(
        allan_content(fit_allan_coefficients(overlapping_allan_deviation(white, rate_hz)), "rad/s")
    )
    found = record.quantity("angle_random_walk")
    assert found.unit == "rad/sqrt(s)"
    assert found.standard_uncertainty is not None
    assert abs(found.value - density) < 3 * found.standard_uncertainty < 0.1 * density
    walk = record.quantity("rate_random_walk")
    assert walk.standard_uncertainty is None
    assert walk.interval is not None
    assert walk.interval.lower == 0.0


def test_a_magnetometers_iron() -> None:
    record = recorded(magnetometer_content(hard_and_soft_iron(_turned(400, 0.02, 1)), "uT", "1"), "mag")
    assert record.quantity("soft_iron_compensation_xy").unit == "1/(uT)"
    truth = {"soft_iron_compensation_yy": COMPENSATION[1, 1], "hard_iron_x": HARD_IRON[0]}
    for name, value in truth.items():
        found = record.quantity(name)
        assert abs(found.value - value) < 4 * (found.standard_uncertainty or 0)


def test_paper_2s_nodes() -> None:
    content = temperature_content(fit_temperature(run(POSES, NODES), ROOM, ROOM_C))
    record = recorded(content, "acc")
    (nodes,) = (table for table in record.tables if table.name == "nodes")
    table = {column.name: column for column in nodes.columns}
    assert table["temperature"].values == tuple(NODES)
    at_hot = [table[f"{word}_x"].values[-1] for word in ("square", "slope", "constant")]
    np.testing.assert_allclose(np.array(at_hot) * [G, 1, 1 / G], VECTORS["coef_abc_fit_on_N"][0], atol=6e-10)
    assert table["square_x"].unit == "1/(m/s^2)"
    assert record.valid_temperature == TemperatureSpan(low_c=-40.0, high_c=70.0)
    # the oracle's reading at the oracle's temperature, and one whose temperature is missing
    output = emulated(np.array([VECTORS["test_E"]] * 2), [VECTORS["T"]] * 2)
    columns = {"t": np.arange(2.0), "temp": np.array([VECTORS["T"], np.nan])}
    columns |= {f"acc_{axis}": output[:, k] for k, axis in enumerate("xyz")}
    units = {"t": "s", "temp": "degC"} | {f"acc_{axis}": "m/s^2" for axis in "xyz"}
    recording = replace(RECORDING, streams={"dut": Stream("dut", "dut", "t", units, columns)})
    found = apply_record(record, recording).recording.stream("dut").si("acc_x", "acc_y", "acc_z")
    np.testing.assert_allclose(found[0] / G, VECTORS["E_out_fit_on_N"], atol=1e-9)
    assert np.isnan(found[1]).all()
    del columns["temp"]
    with pytest.raises(CalibrationError, match="no temperature to look it up by"):
        apply_record(record, replace(RECORDING, streams={"dut": Stream("dut", "dut", "t", units, columns)}))


def test_the_example_in_the_documentation_is_a_record() -> None:
    text = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")
    example = text.split("```json\n")[1].split("```")[0]
    record = parse_record(example, "docs/calibration.md")
    assert record.quantity("bias_x").unit == "m/s^2"
    assert set(json.loads(record.canonical_json())) <= set(json.loads(example))
