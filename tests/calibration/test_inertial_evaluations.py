"""Inertial figures of merit from emulated recordings: the twin's truth, repeatability, refusals."""

import dataclasses
import json
import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from calibration.certificate.composing import certificate
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import speaker
from calibration.certificate.methods import method_words
from calibration.evaluations.by_profile import evaluate_by_profile, has_method
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.recorded import Source, together
from calibration.records.making import Origin, record_of
from calibration.records.record_parts import CodeVersion, SourceRecording
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import twin_text
from protocol.bench_description import Site
from protocol.errors import CalibrationError
from protocol.recordings import Recording, Stream
from tests.calibration.test_certificate_methods import is_english, texts

WARM = {"powered_before_s": 3600.0}
ENGLISH = speaker("en")
UNKNOWN = method_words("no_such", "none", ENGLISH).source
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


def figures(found: MethodEvaluation, sensor: str = "gyro") -> dict[str, tuple[float, float]]:
    """Name → value and standard uncertainty."""
    return {
        one.name: (one.value, one.standard_uncertainty)
        for result in found.results
        for one in result.content.quantities
        if result.sensor == sensor and one.standard_uncertainty is not None
    }


@pytest.mark.parametrize("profile", ["static", "rate_staircase", "tumble"])
def test_figures_lie_around_the_truth(profile: str) -> None:
    values = {"static": {"duration_s": 200.0}}.get(profile, {})
    recording = recorded("gnc_module", profile, values=values, **WARM)
    found = evaluate_by_profile([recording])
    believed = recording.believed["gyro"]
    matrix, bias = np.array(believed["matrix"]), np.radians(believed["bias"])
    # the unit is at 24.8 degC: 0.2 degC times its largest temperature coefficients; 1e-4 rad of mounting
    expected = {f"bias_{a}": (b, 1e-5) for a, b in zip("xyz", bias, strict=True)}
    expected |= {f"scale_factor_{a}": (matrix[i, i], 3e-5) for i, a in enumerate("xyz")}
    expected |= {f"scale_factor_asymmetry_{a}": (0.0, 1e-5) for a in "xyz"}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        pair = "xyz"[i] + "xyz"[j]
        expected[f"nonorthogonality_{pair}"] = ((matrix[i, j] + matrix[j, i]) / 2, 2e-5)
        expected[f"cross_axis_sensitivity_{pair}"] = (matrix[i, j], 1.2e-4)
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        expected[f"misalignment_{'xyz'[axis]}"] = ((matrix[i, j] - matrix[j, i]) / 2, 1.2e-4)
    expected |= {f"g_sensitivity_{a}{b}": (0.0, 0.0) for a in "xyz" for b in "xyz"}
    seen = {name: one for name, one in figures(found).items() if name in expected}
    assert len(seen) == {"static": 3, "rate_staircase": 18, "tumble": 12}[profile]
    for name, (value, doubt) in seen.items():
        true, besides = expected[name]
        assert abs(value - true) < 4 * math.hypot(doubt, besides), name
    if profile == "tumble":
        acc = figures(found, "acc")
        scale = np.array(recording.believed["acc"]["matrix"]).diagonal()
        for letter, true in zip("xyz", scale, strict=True):
            assert abs(acc[f"quadratic_nonlinearity_{letter}"][0]) < 4 * math.hypot(1.5e-5, 3e-6)
            value, doubt = acc[f"scale_factor_{letter}"]
            assert abs(value - true) < 4 * math.hypot(doubt, 3e-5)
    for result in found.results:
        record = record_of(result.content, result.sensor, result.recordings, ORIGIN)
        assert record.stand is not None
        assert record.stand.emulated
        document = certificate(record, CertificateDetails(), "zh")
        identities = {recording.recording_id, "tt3-1", "r-1"}
        assert [text for text in texts(document) if is_english(text) and text not in identities] == []
        assert method_words(record.method, record.model.name, ENGLISH).source != UNKNOWN


ORIGIN = Origin(
    (SourceRecording(recording_id="r-1", sha256="a" * 64, form="mcap"),),
    CodeVersion(package="testloom 0"),
    BEGIN,
)


def test_a_sweep_tells_the_clock_the_delay_and_the_lag() -> None:
    """mems_ahrs: a pole in the gyro, frames with a fixed delay; gnc_module: a clock that is 8 ppm slow."""
    values = {"axis": 1.0, "duration_s": 40.0}
    found = evaluate_by_profile([recorded("mems_ahrs", "sweep", values=values)])
    twin = json.loads(twin_text(product_named("mems_ahrs").twin(1, "U-0001")))
    lag_s, delay_s = (
        next(effect["parameters"][name]["value"] for effect in twin["effects"] if effect["effect"] == kind)
        for kind, name in (("gyro.bandwidth", "time_constant_s"), ("link.fixed_delay", "delay_s"))
    )
    told = figures(found)
    # the emulator's filter runs straight between samples of 5 ms: some more droop, the same delay
    value, doubt = told["total_delay_x"]
    assert abs(value - lag_s - delay_s) < 4 * doubt < 2e-4
    assert told["time_constant_x"][0] == pytest.approx(math.hypot(lag_s, 5e-3 / math.sqrt(6)), rel=0.1)
    table = found.results[0].content.tables[0]
    assert [column.name for column in table.columns] == ["frequency", "gain", "u_gain", "phase", "u_phase"]
    assert table.columns[3].values[-1] < -0.1  # some 3.6 ms at 12 Hz, a lag
    slow = evaluate_by_profile([recorded("gnc_module", "sweep", values=values)])
    beside = {one.name: one.value for one in slow.results[0].beside}
    assert beside["rate of the unit's clock against the stand's"] == pytest.approx(-7.75e-6, abs=2e-6)
    assert abs(figures(slow)["total_delay_x"][0]) < 4 * figures(slow)["total_delay_x"][1]


def test_a_gyro_of_one_axis() -> None:
    recording = recorded("fog", "rate_staircase", values={"steps": 2.0}, **WARM)
    found = evaluate_by_profile([recording])
    told, row = figures(found), np.array(recording.believed["gyro"]["matrix"])[2]
    for name, true in zip(("cross_axis_sensitivity_zx", "cross_axis_sensitivity_zy"), row[:2], strict=True):
        assert abs(told[name][0] - true) < 4e-4  # 1e-4 rad of mounting
    assert told["scale_factor_z"][0] == pytest.approx(row[2], abs=1e-4)
    assert "misalignment_x" not in told
    assert found.results[0].content.model.name == "linear_sensor"


def cut(recording: Recording, first_s: float, last_s: float, run: int) -> Recording:
    """A part of a long recording as a recording of its own, with a clock that begins at 0."""
    streams: dict[str, Stream] = {}
    for name, stream in recording.streams.items():
        time_s = stream.time_s()
        rows = (time_s >= first_s) & (time_s < last_s)
        columns = {key: values[rows] for key, values in stream.columns.items()}
        columns["t"] = time_s[rows] - first_s
        streams[name] = dataclasses.replace(stream, columns=columns)
    started = (BEGIN + timedelta(seconds=first_s)).isoformat()
    test = {**recording.test, "run": run, "started_at": started, "power_on_s": -3600.0 - first_s}
    return dataclasses.replace(recording, recording_id=f"run-{run}", test=test, streams=streams)


def test_what_lies_between_runs_tells_which_repeatability_it_is() -> None:
    """Six times ten minutes: within one power-on the gyro repeats better than switched on anew each time."""
    order = {"rate_hz": 10.0, **WARM}
    whole = recorded("gnc_module", "static", values={"duration_s": 7200.0}, **order)
    runs = [cut(whole, 1200.0 * k, 1200.0 * k + 600.0, k + 1) for k in range(6)]
    (group,) = together([Source(run) for run in runs])
    stayed_on = evaluate_by_profile([source.recording for source in group])
    assert "runs of one power-on, at least 10 min apart" in stayed_on.assumptions
    anew = [
        recorded("gnc_module", "static", values={"duration_s": 600.0}, run=k, started_at=started, **order)
        for k, started in enumerate((f"2026-01-0{day}T00:00:00Z" for day in range(1, 7)), start=1)
    ]
    switched = evaluate_by_profile(anew)
    sigma, turn_on = math.radians(5.4 / 3600), math.radians(2.9 / 3600)
    average = 2 * 0.5 * (1 - 0.5 * (1 - math.exp(-2)))  # of a Gauss-Markov term over two of its times
    for found, name, true in (
        (stayed_on, "bias_repeatability", math.sqrt(average) * sigma),
        (switched, "turn_on_bias_repeatability", math.hypot(turn_on, math.sqrt(average) * sigma)),
    ):
        over = [result for result in found.results if result.content.method == "repeatability"]
        assert [result.sensor for result in over] == ["gyro", "acc"]
        pooled = math.sqrt(np.mean([figures(found)[f"{name}_{axis}"][0] ** 2 for axis in "xyz"]))
        assert true / 2 < pooled < 2 * true  # 15 degrees of freedom, a level that differs by unit
        assert over[0].content.tables[0].row_names == found.recording_ids[-6:]
    contradictory = [dataclasses.replace(run, test=runs[0].test) for run in runs]
    refused = evaluate_by_profile(contradictory)
    assert {result.content.method for result in refused.results} == {"allan_variance", "bias"}
    assert any("overlap in time" in note.why for note in refused.not_used)
    few = evaluate_by_profile(runs[:3])
    assert any("3 runs carry no repeatability" in note.why for note in few.not_used)
    mixed = evaluate_by_profile([*runs[:5], anew[5]])
    assert any("some are not" in note.why for note in mixed.not_used)


def test_an_hour_tells_the_bias_stability() -> None:
    hour = recorded("gnc_module", "static", values={"duration_s": 3600.0}, rate_hz=10.0, **WARM)
    found = evaluate_by_profile([hour])
    told, acc = figures(found), figures(found, "acc")
    level = math.radians(5.4 / 3600)
    for axis in "xyz":
        value, doubt = told[f"bias_stability_{axis}"]
        assert level / 3 < value < 3 * level  # white noise of 10 s and a wander of 300 s
        assert 0.05 < doubt / value < 0.6  # a dozen independent values, not 360
        assert f"bias_stability_{axis}" in acc
    assert "bias_x" not in acc


def test_the_stand_may_look_another_way() -> None:
    """At an azimuth of 60 deg the Earth rate lies otherwise in the body; the bias is the same."""
    at = Site(latitude_deg=50.0, gravity_m_s2=9.81, heading_deg=60.0)
    order = {"values": {"duration_s": 200.0}, **WARM}
    there = figures(evaluate_by_profile([recorded("gnc_module", "static", site=at, **order)]))
    usual = figures(evaluate_by_profile([recorded("gnc_module", "static", **order)]))
    for axis in "xyz":
        # the same noise; another gravity; a wrong azimuth moves it by 5e-5
        assert abs(there[f"bias_{axis}"][0] - usual[f"bias_{axis}"][0]) < 6e-7


def test_what_is_not_known_is_said() -> None:
    static = recorded("gnc_module", "static", values={"duration_s": 200.0})
    one_axis = recorded("gnc_module", "rate_staircase", values={"axis": 1.0, "steps": 2.0})
    assert has_method(static)
    for changed in (
        dataclasses.replace(static, site={}),
        dataclasses.replace(static, test={**static.test, "triggered": False}),
    ):
        found = evaluate_by_profile([changed])
        assert figures(found)["bias_x"][1] == pytest.approx(7.292e-5 / math.sqrt(3), rel=0.2)
        assert any("Earth rate not known in body axes" in sentence for sentence in found.assumptions)
    stand = static.streams["stand"]
    turning = {**stand.columns, "rate_z": np.full(len(stand), 1.0)}
    moved = dataclasses.replace(stand, columns=turning)
    with pytest.raises(CalibrationError, match="moved"):
        evaluate_by_profile(
            [dataclasses.replace(static, streams={**static.streams, "stand": moved}, believed={})]
        )
    tilted = {**stand.columns, "angle_middle": np.full(len(stand), 30.0)}
    angles = dataclasses.replace(stand, columns=tilted)
    found = evaluate_by_profile([dataclasses.replace(static, streams={**static.streams, "stand": angles})])
    assert any("tell different attitudes" in sentence for sentence in found.assumptions)
    for recording, words in (
        (one_axis, "turns about body y, z"),
        (dataclasses.replace(one_axis, site={}), "latitude_deg"),
        (dataclasses.replace(one_axis, test={**one_axis.test, "triggered": False}), "trigger"),
    ):
        with pytest.raises(CalibrationError, match=words):
            evaluate_by_profile([recording])
