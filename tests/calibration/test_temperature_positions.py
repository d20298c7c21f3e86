"""Thermal positions of emulated units, from recordings to header; the twin's own effects are the truth."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.temperature_compensation import TemperatureModel
from calibration.algorithms.thermal_soaks import SoakReadings, fit_soaks, spline_weights, told_powers
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.evaluations.thermal_positions import soak_readings
from calibration.recorded import Source, together
from calibration.records.temperature_contents import temperature_content
from cli.main import main
from dut_emulator.effects.effect import EffectChain, Stage, Stimulus
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.folder_form import write_folder
from protocol.recordings import Recording
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white

VALUES = {"soak_s": 900.0, "ramp_c_per_min": 5.0, "levels": 12.0, "rate_deg_s": 100.0}
RANDOM = {
    "white_noise",
    "bias_instability",
    "quantization",
    "warm_up",
    "thermal_hysteresis",
    "temperature_rate",
}
"""Not a function of input and temperature."""
G = 9.80665


def thermal(seed: int, mount: int, twin=None, **values: float) -> Recording:
    chosen = VALUES | values | {"mount": float(mount)}
    return recorded(
        "mems_ahrs", "thermal_positions", values=chosen, mount=f"m{mount}", seed=seed, twin=twin, rate_hz=4.0
    )


def at_room(seed: int, twin=None) -> list[Recording]:
    return [
        recorded("mems_ahrs", profile, seed=seed, twin=twin, powered_before_s=1800.0)
        for profile in ("multi_position", "rotation")
    ]


def followed(seed: int):
    """The unit without what sigma(N, T) cannot follow: axes that turn with temperature, hysteresis."""
    twin = product_named("mems_ahrs").twin(seed, "U-0001")
    without = {"misalignment_temperature", "thermal_hysteresis", "warm_up"}
    return dataclasses.replace(twin, effects=tuple(e for e in twin.effects if e.word not in without))


def true_output(twin, kind: str, inputs: np.ndarray, temperature_c: np.ndarray) -> np.ndarray:
    """Outputs (m, 3) of the twin's deterministic sensor, by its own effects."""
    effects = [
        effect
        for effect in twin.effects
        if effect.sensor == kind
        and effect.word not in RANDOM
        and effect.stage < Stage.TRANSPORT
        and effect.word not in ("bandwidth", "saturation", "g_sensitivity")
    ]
    chain = EffectChain(effects)
    time_s = np.arange(len(inputs), dtype=np.float64)
    stimulus = Stimulus(time_s, temperature_c, 1.0)
    return chain.apply(inputs, stimulus, chain.begin(np.random.SeedSequence(0)))


def true_sigma(twin, kind: str, inputs: np.ndarray, temperature_c: float, room_c: float):
    """N at temperature (m, 3), and what it has more than at room temperature."""
    hot = true_output(twin, kind, inputs, np.full(len(inputs), temperature_c))
    return hot, hot - true_output(twin, kind, inputs, np.full(len(inputs), room_c))


PROBES = {
    "acc": G * np.array([[0.6, -0.3, 0.74], [-0.9, 0.1, 0.4], [0.2, 0.9, -0.3], [0.0, 0.0, 0.0]]),
    "gyro": np.radians([[60.0, -30.0, 74.0], [-90.0, 10.0, 40.0], [20.0, 90.0, -30.0], [0.0, 0.0, 0.0]]),
}
AT_C = (-25.0, 0.0, 45.0, 66.0)


def pulls(model: TemperatureModel, twin, kind: str, room_c: float) -> np.ndarray:
    """(estimate - truth) / u of sigma, at outputs and temperatures between the nodes."""
    found = []
    for temperature_c in AT_C:
        output, truth = true_sigma(twin, kind, PROBES[kind], temperature_c, room_c)
        at = np.full(len(output), temperature_c)
        found.append((model.sigma(output, at) - truth) / model.sigma_standard_uncertainty(output, at))
    return np.concatenate(found).ravel()


def fitted(recordings: list[Recording], kind: str, room_c: float) -> TemperatureModel:
    notes: list = []
    readings = soak_readings(recordings, kind, notes)
    believed = recordings[0].believed[kind]["bias_instability"]
    unit = {"deg/h": np.radians(1.0) / 3600.0, "mg": 1e-3 * G}[believed["unit"]]
    room = TriadCoefficients("acceleration", np.eye(3), np.zeros(3), np.zeros((12, 12)), 0.0, 0)
    slow = ((believed["value"] * unit, believed["correlation_time_s"]),)
    return fit_soaks(readings, room, room_c, slow).model


@pytest.mark.slow
def test_twenty_units_by_the_whole_route_are_covered() -> None:
    """Chamber recordings of 20 units without what sigma(N, T) cannot follow."""
    found: dict[str, list[np.ndarray]] = {"acc": [], "gyro": []}
    for seed in range(1, 21):
        twin = followed(seed)
        recordings = [thermal(seed, mount, twin, soak_s=500.0, levels=9.0) for mount in (1, 2, 3)]
        for kind, each in found.items():
            each.append(pulls(fitted(recordings, kind, 27.0), twin, kind, 27.0))
    for kind, each in found.items():
        inside = np.abs(np.array(each))
        # 48 figures of a unit hang together: the 20 units count, not the 960 figures.
        assert 0.6 < (inside < 1.0).mean() < 0.9, kind
        assert (inside < 1.96).mean() > 0.9, kind


def _soaks(twin, kind: str, mounts: int = 2, levels: int = 9):
    """Clean readings of every pose at every soak: outputs, temperature, pose, time."""
    inputs, pose, temperature, time = [], [], [], []
    span = G if kind == "acc" else np.radians(100.0)
    for mount in range(mounts):
        across = [k for k in range(3) if k != mount]
        poses = []
        if kind == "acc":
            for k, sign in ((across[0], 1.0), (across[1], 1.0), (across[0], -1.0), (across[1], -1.0)):
                poses.append(span * sign * np.eye(3)[k])
        else:
            poses = [span * sign * np.eye(3)[mount] for sign in (1.0, -1.0)] + [np.zeros(3)] * 3
        for soak, degrees in enumerate(np.linspace(-34.0, 72.0, levels)):
            for number, one in enumerate(poses):
                for part in range(2):
                    inputs.append(one)
                    pose.append(10 * mount + number)
                    temperature.append(degrees + 0.05 * number)
                    time.append(mount * 1e7 + soak * 1800.0 + number * 12.0 + part * 5.0 + 2.5)
    inputs, temperature = np.array(inputs), np.array(temperature)
    clean = true_output(twin, kind, inputs, temperature)
    order = np.array(time)
    return clean, temperature, np.array(pose), order


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["white", "exponential", "flicker"])
def test_two_hundred_units_are_covered_on_noise_of_another_maker(shape: str) -> None:
    """Noise from spectra, not from the emulator's recursions; its stated level is a Gauss-Markov term."""
    room = TriadCoefficients("acceleration", np.eye(3), np.zeros(3), np.zeros((12, 12)), 0.0, 0)
    rng = np.random.default_rng(5)
    level, density, step_s = 1e-3, (1e-3) ** 2, 5.0
    found = []
    for seed in range(1, 201):
        twin = followed(seed)
        clean, temperature, pose, time_s = _soaks(twin, "acc", levels=7 if shape == "flicker" else 9)
        noise = np.empty_like(clean)
        for mount in range(2):
            rows = np.flatnonzero(time_s // 1e7 == mount)
            at = ((time_s[rows] - mount * 1e7) / step_s).astype(int)
            slow = {
                "white": lambda: np.zeros((4200, 3)),
                "exponential": lambda: exponential(rng, 4200, 3, level, 300.0, step_s),
                "flicker": lambda: flicker(rng, 4200, 3, level / 2.0, step_s),
            }[shape]()
            noise[rows] = (slow + white(rng, 4200, 3, density, step_s))[at]
        readings = SoakReadings(clean + noise, temperature, pose, time_s, np.full(len(clean), 5.0))
        slow_terms = {"white": (), "exponential": ((level, 300.0),), "flicker": None}[shape]
        found.append(pulls(fit_soaks(readings, room, 27.0, slow_terms).model, twin, "acc", 27.0))
    check_coverage(np.array(found), less=0.05 if shape == "flicker" else 0.03, more=0.2)


def test_the_spline_through_soaks_is_the_one_without_jumps() -> None:
    knots = np.array([-34.0, -14.0, 6.0, 26.0, 46.0, 72.0])
    places = np.linspace(-36.0, 74.0, 56)
    curve = np.polynomial.Polynomial([0.0, 1.0, 0.02, 3e-4])
    inside = (places > knots[0]) & (places < knots[-1])
    by_spline = spline_weights(knots, places) @ curve(knots)
    np.testing.assert_allclose(by_spline[inside], curve(places)[inside], atol=1e-9)  # any cubic
    independent = CubicSpline(knots, np.exp(knots / 30.0))
    found = spline_weights(knots, places) @ np.exp(knots / 30.0)
    np.testing.assert_allclose(found[inside], independent(places)[inside], rtol=1e-12)
    line = 3.0 + 2.0 * knots
    np.testing.assert_allclose(spline_weights(knots, places) @ line, 3.0 + 2.0 * places, rtol=1e-12)
    np.testing.assert_allclose(spline_weights(knots, knots), np.eye(6), atol=1e-12)


def test_inputs_tell_as_many_powers_as_they_are() -> None:
    pose = np.repeat(np.arange(4), 2)
    wobble = np.tile([1e-4, -1e-4], 4)
    for means, powers in (((1, 0, -1, 0), (2, 1, 0)), ((1, 1, -1, -1), (1, 0)), ((0, 0, 0, 0), (0,))):
        assert told_powers(np.repeat(np.array(means, dtype=float), 2) + wobble, pose, "quadratic") == powers
    assert told_powers(np.repeat([1.0, 0.0, -1.0, 0.0], 2) + wobble, pose, "linear") == (1, 0)


@pytest.fixture(scope="module")
def session() -> list[Recording]:
    short = {"soak_s": 600.0, "levels": 4.0}
    return [*(thermal(3, mount, **short) for mount in (2, 3)), *at_room(3)]


def test_recordings_become_records_and_a_header(session: list[Recording], tmp_path: Path, capsys) -> None:
    folders = []
    for number, recording in enumerate(session):
        folders.append(str(tmp_path / f"r{number}"))
        write_folder(dataclasses.replace(recording, recording_id=f"r{number}"), Path(folders[-1]))
    assert main(["calibrate", *folders, "--record", str(tmp_path / "records"), "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert result["method"] == "temperature_compensation"
    paths = {one["sensor"]: one["path"] for one in result["records"]}
    assert set(paths) == {"acc", "gyro"}
    assert any("beyond" in sentence for sentence in result["assumptions"])
    acc = json.loads(Path(paths["acc"]).read_text())
    tables = {table["name"] for table in acc["tables"]}
    assert {"nodes", "bias_over_temperature", "residuals", "node_correlation_x"} <= tables
    assert main(["calibrate", "header", paths["acc"], "--out", str(tmp_path / "acc.h")]) == 0
    assert "U-0001" in (tmp_path / "acc.h").read_text()
    # Compensated chamber recordings lie nearer to the stand's truth than with the frozen matrix alone.
    target = tmp_path / "compensated"
    assert main(["calibrate", "apply", paths["acc"], folders[0], "--out", str(target)]) == 0


def test_the_record_gives_its_model_back() -> None:
    from calibration.records.temperature_contents import model_of_record
    from tests.calibration.test_record_contents import recorded as as_record

    clean, temperature, pose, time_s = _soaks(followed(2), "acc")
    rng = np.random.default_rng(1)
    readings = SoakReadings(
        clean + rng.normal(0.0, 1e-3, clean.shape), temperature, pose, time_s, np.full(len(clean), 5.0)
    )
    room = TriadCoefficients("acceleration", np.eye(3), np.zeros(3), 1e-8 * np.eye(12), 1e-3, 10)
    model = fit_soaks(readings, room, 27.0, ()).model
    back = model_of_record(as_record(temperature_content(model), "acc"))
    output, at = rng.uniform(-G, G, (40, 3)), rng.uniform(-40.0, 80.0, 40)
    np.testing.assert_allclose(back.sigma(output, at), model.sigma(output, at), rtol=1e-12)
    np.testing.assert_allclose(
        back.sigma_standard_uncertainty(output, at), model.sigma_standard_uncertainty(output, at), rtol=1e-9
    )


def test_what_is_missing_is_named(session: list[Recording]) -> None:
    chamber, room = session[:2], session[2:]
    with pytest.raises(CalibrationError, match="frozen from room temperature"):
        evaluate_by_profile(chamber)
    with pytest.raises(CalibrationError, match="needs a recording 'rotation' too"):
        evaluate_by_profile([*chamber, room[0]])
    with pytest.raises(CalibrationError, match="3 or more"):
        evaluate_by_profile([thermal(3, 2, soak_s=600.0, levels=2.0), *room])
    alone = evaluate_by_profile([chamber[0], *room])  # body y along the axis: acc y never sees gravity
    assert any("acc_y: square and slope over temperature not told" in one for one in alone.assumptions)
    groups = together([Source(one) for one in (*room, *chamber)])
    assert [source.profile for source in groups[0]] == ["thermal_positions"] * 2 + [
        "multi_position",
        "rotation",
    ]
    assert len(groups) == 1
