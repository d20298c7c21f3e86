"""Emulated recordings by profile: the twin's truth within what the uncertainty says, and what is refused."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration.evaluations.by_profile import evaluate_by_profile, has_method
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.recorded import Source, together
from cli.main import main
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import twin_text
from protocol.errors import CalibrationError
from protocol.folder_form import write_folder
from protocol.language import choose_language
from protocol.recordings import Recording, Stream

SEEDS = (1, 2, 3)


@pytest.fixture(autouse=True)
def _english():
    yield
    choose_language("en")


def truth(product: str, seed: int) -> dict[tuple[str, str], float]:
    """(effect, parameter) → value, of the unit's own twin."""
    twin = json.loads(twin_text(product_named(product).twin(seed, "U-0001")))
    return {
        (effect["effect"], name): one["value"]
        for effect in twin["effects"]
        for name, one in effect["parameters"].items()
    }


def quantity(found: MethodEvaluation, sensor: str, name: str) -> tuple[float, float]:
    """Value and standard uncertainty."""
    for result in found.results:
        for one in result.content.quantities:
            if (result.sensor, one.name) == (sensor, name):
                assert one.standard_uncertainty is not None
                return one.value, one.standard_uncertainty
    raise AssertionError((sensor, name, [result.sensor for result in found.results]))


def with_columns(recording: Recording, stream: str, **columns: np.ndarray | None) -> Recording:
    """Columns replaced; None: taken away."""
    old = recording.streams[stream]
    kept = {name: values for name, values in old.columns.items() if columns.get(name, values) is not None}
    kept |= {name: values for name, values in columns.items() if values is not None}
    units = {name: old.units[name] for name in kept}
    new = dataclasses.replace(old, columns=kept, units=units)
    return dataclasses.replace(recording, streams={**recording.streams, stream: new})


def without_stream(recording: Recording, name: str) -> Recording:
    return dataclasses.replace(
        recording, streams={key: one for key, one in recording.streams.items() if key != name}
    )


def untriggered(recording: Recording) -> Recording:
    return dataclasses.replace(recording, test={**recording.test, "triggered": False})


@pytest.fixture(scope="module")
def impact() -> Recording:
    return recorded("fog", "impact", values={"shots": 25, "spacing_s": 0.9}, seed=1)


@pytest.fixture(scope="module")
def eleven_point() -> Recording:
    return recorded(
        "rate_gyro_triad", "eleven_point", values={"axis": 1.0, "cycles": 2.0, "rest_s": 1.0}, seed=1
    )


@pytest.fixture(scope="module")
def overloads() -> tuple[Recording, ...]:
    values = {"overload_g": 10.0, "cycles": 40.0}
    return tuple(
        recorded("pulse_imu", "overload", values=values | {"axis": float(axis)}, seed=1, mount=f"m{axis}")
        for axis in (1, 2, 3)
    )


@pytest.fixture(scope="module")
def spin() -> Recording:
    return recorded(
        "gnc_module", "spin", values={"max_rate_rev_s": 3.7, "steps": 2.0, "dwell_s": 12.0}, seed=1
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_pure_lag_lies_between_its_bounds(seed: int) -> None:
    """A gyro that is one axis and one frame period: U(0, T_f) of phase, so the bounds hold for certain."""
    recording = recorded("fog", "impact", values={"shots": 25, "spacing_s": 0.9}, seed=seed)
    found = evaluate_by_profile([recording])
    (result,) = found.results
    (lag,) = result.content.quantities
    true_s = truth("fog", seed)["link.fixed_delay", "delay_s"]
    assert result.sensor == "gyro_z"
    assert lag.interval is not None
    rise_s = 0.2e-6  # trigger latency and the pole until 5 sigma
    assert lag.interval.lower - rise_s <= true_s <= lag.interval.upper + rise_s
    assert lag.interval.upper - lag.interval.lower < 500e-6 * 11 / 24
    beside = {one.name.split(" ")[0]: one.value for one in result.beside if one.unit == "1"}
    # a = 0.1: 1 - 0.9^24 (1 + 2.4) and, as printed, 1 - (1 - 0.01)^300
    assert beside["probability"] == pytest.approx(1 - 0.9**24 * 3.4)
    assert beside["the"] == pytest.approx(1 - 0.99**300)


def test_impacts_that_tell_nothing(impact: Recording) -> None:
    stamp = impact.streams["dut"].columns["stamp"]
    output = impact.streams["dut"].columns["gyro_z"]
    begins = np.flatnonzero((stamp[:-1] == 0) & (stamp[1:] > 0)) + 1
    once = stamp.copy()
    once[begins[1] - 5 :] = 0
    saturated = np.where(stamp > 0, 0xFFFF, 0).astype(np.uint16)
    for changed, words in (
        (with_columns(impact, "dut", stamp=None), "stamp"),
        (with_columns(impact, "dut", stamp=np.zeros_like(stamp)), "trigger"),
        (with_columns(impact, "dut", stamp=once), "shots"),
        (with_columns(impact, "dut", stamp=saturated), "end of the timer"),
        (with_columns(impact, "dut", gyro_z=np.full_like(output, 2000)), "does not move"),
        (with_columns(impact, "dut", gyro_z=None), "no gyro"),
    ):
        with pytest.raises(CalibrationError, match=words) as error:
            evaluate_by_profile([changed])
        assert error.value.remedy
    lost = np.delete(np.arange(len(stamp)), begins[3])
    dut = impact.streams["dut"]
    shorter = {name: values[lost] for name, values in dut.columns.items()}
    found = evaluate_by_profile(
        [dataclasses.replace(impact, streams={"dut": dataclasses.replace(dut, columns=shorter)})]
    )
    assert [(one.count, "lost" in one.why) for one in found.not_used] == [(1, True)]


@pytest.mark.parametrize("seed", SEEDS)
def test_rate_gyros_line_is_the_twins(seed: int) -> None:
    values = {"axis": 2.0, "cycles": 2.0, "rest_s": 1.0}
    recording = recorded("rate_gyro_triad", "eleven_point", values=values, seed=seed)
    found = evaluate_by_profile([recording])
    assert [result.sensor for result in found.results] == ["gyro_y"]
    twin = truth("rate_gyro_triad", seed)
    warmth = float(recording.streams["dut"].columns["temp"].mean()) - 25.0
    true = math.degrees(0.050698) * (1 + twin["gyro.scale_factor_error", "scale_factor_error_y"])
    true *= 1 + warmth * twin["gyro.scale_factor_temperature", "coefficients_per_c_1_y"]
    slope, doubt = quantity(found, "gyro_y", "scale_factor")
    assert abs(slope - true) < 3 * doubt < 2e-3 * true
    # the loop of 2 h over 200 deg/s
    loop = 2 * abs(twin["gyro.rate_hysteresis", "amplitude_si_y"]) / math.radians(200.0)
    hysteresis, doubt = quantity(found, "gyro_y", "hysteresis")
    assert -3 * doubt < hysteresis - loop < 5 * doubt  # the largest of eleven


def test_points_that_cannot_be_used(eleven_point: Recording) -> None:
    points = eleven_point.streams["points"]
    volts = eleven_point.streams["dut"].columns["volt_x"]
    shorter = {name: values[:-1] for name, values in points.columns.items()}
    missing = {**eleven_point.streams, "points": dataclasses.replace(points, columns=shorter)}
    for changed, words in (
        (without_stream(eleven_point, "points"), "points"),
        (with_columns(eleven_point, "points", cycle=None), "cycle"),
        (with_columns(eleven_point, "dut", volt_x=None), "volt_x"),
        (untriggered(eleven_point), "trigger"),
        (dataclasses.replace(eleven_point, streams=missing), "missing"),
        (with_columns(eleven_point, "dut", volt_x=volts * 10.0), "end of the range"),
        (with_columns(eleven_point, "dut", volt_x=np.full_like(volts, 0.01)), "does not follow"),
    ):
        with pytest.raises(CalibrationError, match=words) as error:
            evaluate_by_profile([changed])
        assert error.value.remedy


@pytest.mark.parametrize("crank", [0.0, 1.0])
def test_overload_gives_the_twins_asymmetry(crank: float) -> None:
    for seed in SEEDS:
        values = {"overload_g": 10.0, "cycles": 30.0, "axis": 1.0, "crank": crank}
        found = evaluate_by_profile([recorded("pulse_imu", "overload", values=values, seed=seed)])
        twin = truth("pulse_imu", seed)
        for name, true in (
            ("scale_factor_asymmetry", twin["acc.scale_factor_asymmetry", "asymmetry_x"]),
            ("odd_quadratic_nonlinearity", twin["acc.odd_quadratic_nonlinearity", "odd_square_x"]),
        ):
            value, doubt = quantity(found, "acc_x", name)
            assert abs(value - true) < 3 * doubt, (seed, name)
        dead = {row for row in "xyz" if twin["gyro.scale_factor_error", f"scale_factor_error_{row}"] == -1.0}
        assert len(found.not_used) == len(dead)
        for row in sorted(set("xyz") - dead):
            value, doubt = quantity(found, "gyro", f"g_sensitivity_{row}x")
            assert abs(value - twin["gyro.g_sensitivity", f"acc_{row}x"]) < 4 * doubt


def test_three_directions_tell_all_of_d(overloads: tuple[Recording, ...]) -> None:
    (group,) = together([Source(one) for one in overloads])
    found = evaluate_by_profile([source.recording for source in group])
    assert [one.sensor for one in found.results] == ["acc_x", "acc_y", "acc_z", "gyro"]
    assert [len(one.recordings) for one in found.results] == [1, 1, 1, 3]
    twin = truth("pulse_imu", 1)
    pulls = []
    for row in "xyz":
        for column in "xyz":
            value, doubt = quantity(found, "gyro", f"g_sensitivity_{row}{column}")
            pulls.append((value - twin["gyro.g_sensitivity", f"acc_{row}{column}"]) / doubt)
    assert np.abs(pulls).max() < 4
    assert np.sqrt(np.mean(np.square(pulls))) < 2


def test_overload_that_cannot_be_used(overloads: tuple[Recording, ...]) -> None:
    first = overloads[0]
    pulses = first.streams["dut"].columns["pulse_acc_x_pos"]
    no_axis = {key: value for key, value in first.test["values"].items() if key != "axis"}
    dut = first.streams["dut"]
    hole = {name: np.delete(values, 5000) for name, values in dut.columns.items()}
    short = {
        name: dataclasses.replace(one, columns={key: values[:900] for key, values in one.columns.items()})
        for name, one in first.streams.items()
    }
    unsteady = first.streams["stand"].columns["position"] * (1 + 0.1 * np.linspace(0, 1, len(pulses)))
    for changed, words in (
        (with_columns(first, "stand", position=None), "position"),
        (with_columns(first, "dut", pulse_acc_x_neg=None), "pulse_acc_x_neg"),
        (dataclasses.replace(first, test={**first.test, "values": no_axis}), "axis"),
        (dataclasses.replace(first, believed={}), "beforehand"),
        (untriggered(first), "trigger"),
        (with_columns(first, "dut", pulse_acc_x_pos=np.minimum(pulses * 3, 201)), "end of its range"),
        (
            dataclasses.replace(
                first, streams={**first.streams, "dut": dataclasses.replace(dut, columns=hole)}
            ),
            "hole",
        ),
        (dataclasses.replace(first, streams=short), "cycles"),
        (with_columns(first, "stand", position=unsteady), "steady"),
    ):
        with pytest.raises(CalibrationError, match=words) as error:
            evaluate_by_profile([changed])
        assert error.value.remedy


@pytest.mark.parametrize(
    ("product", "parameter"),
    [("fog", "gyro.angle_random_walk"), ("rate_gyro_triad", "gyro.angle_random_walk")],
)
def test_random_walk_is_the_twins(product: str, parameter: str) -> None:
    recording = recorded(product, "static", values={"duration_s": 200.0}, seed=2, powered_before_s=7200.0)
    found = evaluate_by_profile([recording])
    twin = truth(product, 2)
    noise = [result for result in found.results if result.content.method == "allan_variance"]
    for result in noise:
        true = twin[parameter, f"density_si_per_sqrt_hz_{result.sensor[-1]}"]
        value, doubt = quantity(found, result.sensor, "angle_random_walk")
        # a filter of some 40 Hz and the sampling shape the first taus: 5 %
        assert abs(value - true) < 4 * math.hypot(doubt, 0.05 * true), result.sensor
    assert len(noise) == (1 if product == "fog" else 3)


def test_too_short_a_rest_and_a_stuck_channel() -> None:
    recording = recorded("gnc_module", "static", values={"duration_s": 60.0})
    with pytest.raises(CalibrationError, match="too short") as error:
        evaluate_by_profile([recording])
    assert "180" in (error.value.remedy or "")
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 200.0, 0.05)
    time_s[2000:] += 5.0  # a hole after 100 s, and 100 s behind it
    columns = {"t": np.r_[time_s, time_s[-1] + 0.05 * np.arange(1, 3000)]}
    columns |= {"gyro_x": 1e-3 * rng.standard_normal(len(columns["t"])), "gyro_y": np.ones(len(columns["t"]))}
    units = {"t": "s", "gyro_x": "rad/s", "gyro_y": "rad/s"}
    made = Recording(
        "r",
        {"serial": "U", "product": "p"},
        {"profile": "static"},
        {"dut": Stream("dut", "d", "t", units, columns)},
    )
    found = evaluate_by_profile([made])
    assert [one.sensor for one in found.results] == ["gyro_x", "gyro"]
    assert [one.name for one in found.results[1].content.quantities] == ["bias_x", "bias_trend_x"]
    assert quantity(found, "gyro_x", "angle_random_walk")[0] == pytest.approx(1e-3 * math.sqrt(0.05), rel=0.1)
    left_out = {(note.what, note.count): note.why for note in found.not_used}
    assert ("samples of the recording", 2000) in left_out
    assert "constant" in left_out["gyro_y", 4999]


@pytest.mark.parametrize("seed", SEEDS)
def test_spin_gives_the_magnetometers_ellipse(seed: int) -> None:
    values = {"max_rate_rev_s": 3.7, "steps": 2.0, "dwell_s": 12.0}
    recording = recorded("gnc_module", "spin", values=values, seed=seed)
    found = evaluate_by_profile([recording])
    believed = recording.believed["mag"]
    matrix, bias = np.array(believed["matrix"]), np.array(believed["bias"]) * 1e-4
    along = float(recording.streams["stand"].columns["mag_z"].mean()) * 1e-6
    plane = matrix[:2, :2] @ matrix[:2, :2].T
    expected = {
        "hard_iron_x": bias[0] + matrix[0, 2] * along,
        "hard_iron_y": bias[1] + matrix[1, 2] * along,
        "sensitivity_ratio_xy": math.sqrt(plane[0, 0] / plane[1, 1]),
        "nonorthogonality_xy": math.asin(plane[0, 1] / math.sqrt(plane[0, 0] * plane[1, 1])),
    }
    warmth = {"sensitivity_ratio_xy": 1e-3}  # 2 degC times the temperature coefficients of two channels
    for name, true in expected.items():
        value, doubt = quantity(found, "mag", name)
        assert abs(value - true) < 3 * math.hypot(doubt, warmth.get(name, 0.0)), name


def test_spins_that_tell_nothing(spin: Recording) -> None:
    stand = spin.streams["stand"].columns
    mag = spin.streams["dut"].columns["mag_x"]
    still = {f"rate_{axis}": np.zeros_like(stand["rate_x"]) for axis in "xyz"}
    gyros = dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"))
    for changed, words in (
        (with_columns(spin, "dut", mag_x=None), "mag_x"),
        (with_columns(spin, "stand", **still), "did not turn"),
        (with_columns(without_stream(spin, "stand"), "dut", **gyros), "which axis"),
        (with_columns(spin, "dut", mag_x=np.full_like(mag, 6.0)), "end of its range"),
    ):
        with pytest.raises(CalibrationError, match=words) as error:
            evaluate_by_profile([changed])
        assert error.value.remedy
    by_gyros = evaluate_by_profile([without_stream(spin, "stand")])
    for name in ("hard_iron_x", "nonorthogonality_xy"):
        (a, u), (b, _) = (quantity(one, "mag", name) for one in (by_gyros, evaluate_by_profile([spin])))
        assert abs(a - b) < u


def test_command_evaluates_and_writes_records(
    overloads: tuple[Recording, ...], impact: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for recording in (*overloads, impact):
        write_folder(recording, tmp_path / "runs" / recording.recording_id)
    assert main(["calibrate", str(tmp_path / "runs"), "--json", "--record", str(tmp_path / "kept")]) == 0
    results = {one["profile"]: one for one in json.loads(capsys.readouterr().out)["results"]}
    assert set(results) == {"overload", "impact"}
    assert len(results["overload"]["recordings"]) == 3
    assert [one["sensor"] for one in results["overload"]["records"]] == ["acc_x", "acc_y", "acc_z", "gyro"]
    (lag,) = results["impact"]["results"][0]["quantities"]
    kept = json.loads(Path(results["impact"]["records"][0]["path"]).read_text())
    assert kept["method"] == "pure_lag"
    assert kept["quantities"][0]["value"] == lag["value"]
    assert kept["assumptions"][0].startswith("25 shots")
    rows = json.loads(Path(results["overload"]["records"][3]["path"]).read_text())["recordings"]
    assert len(rows) == 3
    assert main(["--lang", "zh", "calibrate", str(tmp_path / "runs")]) == 0
    shown = capsys.readouterr().out
    assert "纯延迟" in shown
    assert "pure_lag" in shown


def test_other_profiles_are_as_before(impact: Recording) -> None:
    segments = [{"name": "z_up", "kind": "static"}]
    session = dataclasses.replace(impact, test={"profile": "static", "segments": segments})
    assert not has_method(session)
    assert not has_method(dataclasses.replace(impact, test={"profile": "multi_position"}))
    assert has_method(impact)
