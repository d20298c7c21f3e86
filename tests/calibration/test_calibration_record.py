"""Calibration records: one form for one content, refusals, use on a recording, comparison, history."""

import json
import math
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta, timezone

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from calibration.recorded import Source, evaluate
from calibration.records.applying import apply_record
from calibration.records.comparing import compare_records, holm
from calibration.records.derived_units import derived_conversion_factor, derived_unit
from calibration.records.history import fit_trend, history_of
from calibration.records.making import Origin, records_of
from calibration.records.record import parse_record
from calibration.records.record_parts import (
    CodeVersion,
    Interval,
    Model,
    RecordedBudget,
    RecordedBudgetRow,
    RecordTable,
    SourceRecording,
    TableColumn,
    TemperatureSpan,
)
from protocol.errors import CalibrationError, TestloomError
from tests.calibration.calibration_records import (
    quantity,
    record_of,
    triad_record,
    unit_recording,
    with_covariance,
)
from tests.calibration.test_calibrate_command import station_recording

FINITE = st.floats(-1e9, 1e9)


@given(st.lists(FINITE, min_size=1, max_size=4), st.integers(0, 2**31), st.floats(0.1, 5))
def test_what_is_written_is_read_back_and_has_one_form(values: list[float], seed: int, k: float) -> None:
    root = np.random.default_rng(seed).normal(size=(len(values), len(values)))
    covariance = root @ root.T
    record = with_covariance({f"q{i}": v for i, v in enumerate(values)}, (covariance + covariance.T) / 2)
    record = record.model_copy(update={"coverage_probability": 1 / (1 + k)})
    text = record.canonical_json()
    assert parse_record(text, "x") == record
    shuffled = dict(reversed(json.loads(text).items()))
    again = parse_record(json.dumps(shuffled, indent=2), "x")
    assert (again.canonical_json(), again.sha256()) == (text, record.sha256())


def test_equal_contents_are_equal_bytes() -> None:
    there = datetime(2026, 1, 2, 11, 4, 5, tzinfo=timezone(timedelta(hours=8)))
    assert record_of(created_at=there).sha256() == record_of().sha256()
    zeros = [record_of(quantity("bias_x", zero, 0.1)).sha256() for zero in (0.0, -0.0)]
    assert zeros[0] == zeros[1]
    assert record_of(quantity("bias_x", 0.1, 0.1)).sha256() != zeros[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"serial"', '"seriel"', "at serial: Field required"),
        ('"method":"', '"operator":"me","method":"', "at operator: Extra inputs"),
        ("record/1", "record/2", "The format is"),
        ('"value":1.0', '"value":NaN', "NaN is no number"),
        ('"value":1.0', '"value":1e999', "at quantities.0.value"),
        ('"value":1.0', '"value":"1.0"', "at quantities.0.value"),
        ('"unit":"1","value":1.0', '"unit":"furlong","value":1.0', "'furlong' is not known"),
        ("1.0],[1.0,", "1.0],[1.5,", "not symmetric"),
        ("1.0],[1.0,", "3.0],[3.0,", "negative eigenvalue"),
        ('"standard_uncertainty":2.0', '"standard_uncertainty":2.5', "standard uncertainty of a disagree"),
        ('"standard_uncertainty":2.0', '"standard_uncertainty":-2.0', "greater than or equal to 0"),
        ('"parameters":["a"', '"parameters":["c"', "no quantity of the record"),
        ('"name":"b"', '"name":"a"', "two quantities are named a"),
        ('"sensor":"acc"', '"sensor":"acc","sensor":"gyro"', "two keys are named sensor"),
        ("2026-01-02T", "yesterday", "at created_at"),
        ("05Z", "05", "at created_at"),
        ("}", "", "not the JSON"),
    ],
)
def test_what_is_wrong_is_refused_and_named(old: str, new: str, words: str) -> None:
    text = with_covariance({"a": 1.0, "b": 2.0}, [[4.0, 1.0], [1.0, 1.0]]).canonical_json()
    assert old in text
    with pytest.raises(CalibrationError) as refused:
        parse_record(text.replace(old, new, 1), "file.json")
    assert words in refused.value.what
    assert refused.value.where == "file.json"


def test_a_quantity_must_be_known_by_something() -> None:
    with pytest.raises(ValidationError):
        quantity("pure_lag", 2.4e-4, None, "s")
    lag = quantity(
        "pure_lag", 2.4e-4, None, "s", interval=Interval(lower=2.3e-4, upper=2.5e-4, probability=1.0)
    )
    assert parse_record(record_of(lag).canonical_json(), "x").quantities == (lag,)


def test_one_shape_carries_what_the_papers_yield() -> None:
    """Line fit with its budget, overload coefficients, a temperature table, noise coefficients."""
    row = RecordedBudgetRow(
        quantity="table rate",
        estimate=1.0,
        unit="rad/s",
        standard_uncertainty=0.3,
        distribution="uniform",
        sensitivity=-0.04,
    )
    other = row.model_copy(update={"standard_uncertainty": 0.4, "sensitivity": 0.04})
    record = record_of(
        quantity("scale_factor", 2.9, 1e-4, "V/(rad/s)", symbol="K"),
        quantity("scale_factor_asymmetry", 1e-4, 1e-5, "1", symbol="K_a"),
        quantity("odd_quadratic_nonlinearity", 1e-6, 1e-7, "1/(m/s^2)", symbol="K_2"),
        quantity("g_sensitivity_x", 0.01, 1e-3, "deg/s/g", symbol="D_1"),
        quantity("rate_random_walk", 1e-7, 1e-8, "rad/s/sqrt(s)", symbol="K"),
        sensor="gyro_x",
        budgets=(RecordedBudget(result="scale_factor", rows=(row, other)),),
        tables=(
            RecordTable(
                name="nodes",
                columns=(
                    TableColumn(name="temperature", unit="degC", values=(-40.0, 25.0)),
                    TableColumn(name="constant", unit="rad/s", values=(1e-3, 0.0)),
                    TableColumn(name="square", unit="1/(rad/s)", values=(1e-6, 0.0)),
                ),
            ),
        ),
    )
    assert parse_record(record.canonical_json(), "x") == record
    assert record.budgets[0].standard_uncertainty == pytest.approx(0.02)  # 3, 4, 5
    ragged = record.tables[0].model_dump()
    ragged["columns"][0]["values"] = (1.0,)
    with pytest.raises(ValidationError, match="differ in length"):
        RecordTable(**ragged | {"columns": tuple(TableColumn(**c) for c in ragged["columns"])})


def test_derived_units() -> None:
    assert derived_conversion_factor("V/(deg/s)", "mV/(rad/s)") == pytest.approx(1000 * 180 / math.pi)
    assert derived_conversion_factor("mg/(degC)/(V)", "m/s^2/(V)/(degC)") == pytest.approx(9.80665e-3)
    assert derived_conversion_factor("rad/s/sqrt(ms)", "rad/s/sqrt(s)") == pytest.approx(1000**0.5)
    assert derived_unit("1/(rad/sqrt(s))").dimension == ("number", "angle_random_walk")
    for wrong in ("V/deg/s", "V/(furlong)", "", "/(s)", "V/()", "V/(s)" + "/(s)" * 4):
        with pytest.raises(TestloomError, match="is not known"):
            derived_unit(wrong)
    with pytest.raises(TestloomError, match="do not measure the same"):
        derived_conversion_factor("V/(deg/s)", "V/(g)")


def test_compensation_gives_the_true_input_back() -> None:
    true = np.random.default_rng(1).normal(scale=9.0, size=(400, 3))
    recording = unit_recording(true, np.full(400, 25.0))
    for record in (triad_record(), triad_record("mg", 1000 / 9.80665)):
        done = apply_record(record, recording)
        stream = done.recording.stream("dut")
        np.testing.assert_allclose(stream.si("acc_x", "acc_y", "acc_z"), true, atol=1e-12)
        assert stream.units == recording.stream("dut").units
        assert (stream.columns["gyro_x"] == 0.25).all()
        (mark,) = done.recording.extra["compensated"]
        assert mark["record_sha256"] == record.sha256()
        assert mark["recording_id"] == "r-1"
        assert done.recording.believed["acc"] == {"unit": "g"}
        assert mark["believed"] == {"range": 5, "quantum": 1e-6}
        with pytest.raises(CalibrationError, match="compensated already"):
            apply_record(record, done.recording)


def test_beyond_its_temperature_and_in_saturation_it_says_so() -> None:
    true = np.zeros((10, 3))
    true[3, 1] = 60.0  # beyond 5 g
    temperature = [20, 21, 30, 31.0, 31.1, 18.9, 19.0, math.nan, 25, 25]
    recording = unit_recording(true, temperature)
    done = apply_record(triad_record(valid_temperature=TemperatureSpan(low_c=20.0, high_c=30.0)), recording)
    assert (done.samples, done.beyond_temperature, done.saturated) == (10, 2, 1)
    assert apply_record(triad_record(), recording).beyond_temperature is None


@pytest.mark.parametrize(
    ("record", "changes", "words"),
    [
        ({}, {"unit": {"serial": "U-0008", "product": "gnc_module"}}, "of the unit 'U-0007'"),
        ({}, {"unit": {"serial": "U-0007", "product": "fog"}}, "of the product 'gnc_module'"),
        ({"sensor": "mag"}, {}, "The recording has no mag_x"),
        ({"sensor": "gyro"}, {}, "do not measure the same"),
        ({"bias_unit": "rad/s"}, {}, "do not measure the same"),
        ({"model": Model(name="bias")}, {}, "of the model 'bias' cannot be applied"),
    ],
)
def test_what_does_not_belong_together_is_refused(record, changes, words) -> None:
    with pytest.raises(CalibrationError) as refused:
        apply_record(triad_record(**record), unit_recording(np.zeros((3, 3)), [25.0] * 3, **changes))
    assert words in refused.value.what


def test_comparison_by_hand() -> None:
    """C = [[5, 2], [2, 2]], d = (3, 1): d C^-1 d = (2 * 9 - 4 * 3 + 5) / 6; u = sqrt 5 and sqrt 2, k = 2."""
    first = with_covariance({"a": 4.0, "b": 2.0}, [[3.0, 1.0], [1.0, 1.0]])
    second = with_covariance({"a": 1.0, "b": 1.0}, [[2.0, 1.0], [1.0, 1.0]], serial="U-0009")
    found = compare_records(first, second)
    assert found.chi_square == pytest.approx(11 / 6)
    assert found.degrees_of_freedom == 2
    assert found.probability == pytest.approx(math.exp(-11 / 12))  # chi-squared with 2
    assert [one.zeta for one in found.quantities] == pytest.approx([3 / 5**0.5, 1 / 2**0.5])
    assert [one.normalised_error for one in found.quantities] == pytest.approx([1.5 / 5**0.5, 0.5 / 2**0.5])
    assert found.quantities[0].probability == pytest.approx(math.erfc(3 / 10**0.5), rel=1e-6)
    assert found.other_serial
    assert found.shared_recordings == ("s-1",)
    assert found.significant == ()


def test_comparison_converts_units_and_leaves_out_what_cannot_be_compared() -> None:
    first = record_of(quantity("bias_x", 1.0, 0.1, "deg/s"), quantity("bias_y", 1.0, 0.1, "deg/s"))
    second = record_of(
        quantity("bias_x", math.radians(2.0), math.radians(0.1), "rad/s"), quantity("b", 1.0, 0.1)
    )
    (one,) = compare_records(first, second).quantities
    assert one.difference == pytest.approx(-1.0)
    assert one.zeta == pytest.approx(-10 / 2**0.5)
    assert one.significant
    assert compare_records(first, second).not_compared == ("bias_y", "b")
    with pytest.raises(CalibrationError, match="the other of gnc_module gyro"):
        compare_records(first, record_of(sensor="gyro"))
    with pytest.raises(CalibrationError, match="no quantity in common"):
        compare_records(first, record_of(quantity("q", 1.0, 0.1)))
    exact = compare_records(record_of(quantity("q", 1.0, 0.0)), record_of(quantity("q", 2.0, 0.0)))
    assert math.isinf(exact.quantities[0].zeta)
    assert exact.significant == ("q",)


def test_many_quantities_do_not_cry_wolf() -> None:
    """Holm by hand; then 12 quantities that differ by chance only: some |E_n| > 1 often, an alarm rarely."""
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    rng = np.random.default_rng(5)
    beyond = alarms = 0
    rounds = 300
    for _ in range(rounds):
        a, b = (
            record_of(*(quantity(f"q{k}", v, 1.0) for k, v in enumerate(rng.normal(size=12)))) for _ in "ab"
        )
        found = compare_records(a, b)
        beyond += any(abs(one.normalised_error) > 1 for one in found.quantities)
        alarms += bool(found.significant)
    assert beyond / rounds == pytest.approx(1 - 0.9545**12, abs=0.1)
    assert alarms / rounds == pytest.approx(0.05, abs=0.04)


def dated(year: float, value: float, u: float):
    time = datetime(2020, 1, 1, tzinfo=UTC) + timedelta(days=365.25 * year)
    return record_of(quantity("bias_x", value, u, "m/s^2"), measured_at=time)


def test_drift_is_the_weighted_line() -> None:
    """Against numpy's polynomial fit with the same weights, and the closed form for two points."""
    years = np.array([0.0, 0.7, 1.1, 2.5, 4.0])
    values = np.array([1.0, 1.2, 1.1, 1.7, 2.1])
    u = np.array([0.1, 0.2, 0.1, 0.3, 0.2])
    trend = fit_trend(years, values, u)
    (slope, intercept), covariance = np.polyfit(years, values, 1, w=1 / u, cov="unscaled")
    assert trend.drift_per_year == pytest.approx(slope)
    assert trend.birge_ratio is not None
    assert trend.birge_ratio < 1
    assert trend.drift_standard_uncertainty == pytest.approx(covariance[0, 0] ** 0.5)
    at, of_line = trend.at(np.array([0.0]))
    assert at[0] == pytest.approx(intercept)
    assert of_line[0] == pytest.approx(covariance[1, 1] ** 0.5)
    scattered = fit_trend(years, values, u / 10)
    (_, _), scaled = np.polyfit(years, values, 1, w=10 / u, cov=True)
    assert scattered.drift_standard_uncertainty == pytest.approx(scaled[0, 0] ** 0.5)

    (history,) = history_of([dated(2, 5.0, 0.4), dated(0, 1.0, 0.3), dated(0, 1.0, 0.3)])
    assert len(history.points) == 2  # a copy counts once
    assert history.trend.drift_per_year == pytest.approx(2.0)
    assert history.trend.drift_standard_uncertainty == pytest.approx(0.25)  # sqrt(0.3^2 + 0.4^2) / 2
    assert history.trend.drifts
    (alone,) = history_of([dated(0, 1.0, 0.3)])
    assert alone.trend.drift_per_year is None
    assert alone.trend.value == 1.0


def test_an_outlier_is_flagged_and_does_not_bend_the_line() -> None:
    records = [dated(year, 1.0 + 0.5 * year, 0.01) for year in range(8)]
    records[5] = dated(5, 4.5, 0.01)
    (history,) = history_of(records)
    assert [point.outlier for point in history.points] == [k == 5 for k in range(8)]
    assert history.trend.drift_per_year == pytest.approx(0.5)
    (sound,) = history_of(records[:5])
    assert not any(point.outlier for point in sound.points)


def test_sound_histories_are_seldom_called_otherwise() -> None:
    rng = np.random.default_rng(3)
    flagged = drifting = 0
    for _ in range(200):
        (history,) = history_of([dated(year, float(rng.normal()), 1.0) for year in range(6)])
        flagged += any(point.outlier for point in history.points)
        drifting += history.trend.drifts
    assert flagged / 200 < 0.1
    assert drifting / 200 < 0.1


def test_an_evaluation_becomes_a_record_of_each_sensor(synthetic_imu) -> None:
    recording = station_recording(*synthetic_imu.session(21), started_at="2026-03-01T00:00:00+08:00")
    stand = {"id": "tt-1", "kind": "three_axis_turntable", "calibration_due": "2026-02-27"}
    recording = type(recording)(**vars(recording) | {"stand": stand, "site": {"gravity_m_s2": 9.797}})
    evaluation = evaluate([Source(recording)])
    origin = Origin(
        (SourceRecording(recording_id="session-1", sha256="b" * 64, form="mcap"),),
        CodeVersion(package="testloom 0.1.0"),
        datetime(2026, 4, 1, tzinfo=UTC),
    )
    acc, gyro = records_of(evaluation, [recording], origin)
    assert (acc.sensor, gyro.sensor) == ("acc", "gyro")
    assert gyro.quantity("bias_x").unit == "rad/s"
    assert acc.measured_at == datetime(2026, 2, 28, 16, tzinfo=UTC)
    assert acc.stand is not None
    assert acc.stand.calibration_due == date(2026, 2, 27)
    assert acc.stand.calibration_overdue
    assert evaluation.acc is not None
    np.testing.assert_allclose(
        acc.covariance_of([q.name for q in acc.quantities]), evaluation.acc.covariance, rtol=1e-9, atol=1e-30
    )
    truth = [*np.ravel(synthetic_imu.acc_m), *synthetic_imu.acc_b]
    pulls = [(q.value - t) / q.standard_uncertainty for q, t in zip(acc.quantities, truth, strict=True)]
    assert max(map(abs, pulls)) < 3.5
    assert parse_record(acc.canonical_json(), "x") == acc
    done = apply_record(acc, recording).recording.stream("dut")
    x_up = done.si("acc_x", "acc_y", "acc_z")[:100].mean(axis=0)
    assert np.abs(x_up - np.array([9.797, 0, 0])).max() < 0.01

    nameless = type(recording)(**vars(recording) | {"unit": {"product": "gnc_module"}})
    with pytest.raises(CalibrationError, match="do not say the serial"):
        records_of(evaluation, [nameless], origin)
    elsewhere = type(recording)(**vars(recording) | {"site": {"latitude_deg": 95.0}})
    with pytest.raises(CalibrationError, match="at latitude_deg: Input should be less than or equal to 90"):
        records_of(evaluation, [elsewhere], origin)
    assert evaluation.residuals
    broken = replace(evaluation.residuals[0], values=(math.nan,) * 3)
    with pytest.raises(CalibrationError, match="No calibration record can be made"):
        records_of(replace(evaluation, residuals=(broken,)), [recording], origin)
