"""The generator of blind cases holds what it states: noise, signal-to-noise ratio, physics, blindness."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from protocol.adapters.recording_forms import read_recording
from tests.blind.case_plan import LADDER, CaseSpec, plan
from tests.blind.catalogue import Catalogue
from tests.blind.effect_shapes import played
from tests.blind.excitations import KINDS, Excitation, excitation
from tests.blind.generate import make_case, write
from tests.blind.hidden_signals import single
from tests.blind.metric import Metric
from tests.blind.noise import ChannelNoise, InnovationsFilter
from tests.blind.units import drawn_unit

PACKAGES = {"gap_diagnosis", "dut_emulator", "calibration", "protocol", "stations", "cli"}


@pytest.fixture(scope="module")
def short_test() -> Excitation:
    """A tumble of some seconds."""
    return excitation("tumble", (5, 1), stretch=0.12)


def test_whitening_is_the_inverse_covariance() -> None:
    noise = ChannelNoise(1.0, 1.0, ((3.0, 20.0), (2.0, 60.0)))
    lags = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    covariance = np.eye(60) + 9 * np.exp(-lags / 20) + 4 * np.exp(-lags / 60)
    whitening = InnovationsFilter(noise)
    columns, start = whitening(np.eye(60)), whitening.initial_columns(60)
    middle = np.eye(60) - start @ np.linalg.inv(np.eye(2) + start.T @ start) @ start.T
    assert columns.T @ middle @ columns == pytest.approx(np.linalg.inv(covariance), abs=1e-12)


@pytest.mark.parametrize("clusters", [0.2, 4.0, 40.0])
def test_noise_has_the_stated_allan_figures(clusters: float) -> None:
    """Closed forms for white noise, a Gauss–Markov process and a random walk (IEEE 952-1997, annex C)."""
    rate, white, sigma, tau, walk = 10.0, 0.5, 0.3, 15.0, 0.02
    noise = ChannelNoise(rate, white, ((sigma, tau),), walk)
    rng = np.random.Generator(np.random.Philox(3))
    size = int(clusters * rate)
    figures = []
    for _ in range(60):
        means = noise.drawn(rng, 4000).reshape(-1, size).mean(axis=1)
        figures.append(0.5 * np.mean(np.diff(means) ** 2))
    x = clusters / tau
    slow = 2 * sigma**2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x))
    expected = white**2 / size + slow + walk**2 * clusters / 3
    error = np.std(figures) / np.sqrt(len(figures))
    assert np.mean(figures) == pytest.approx(expected, abs=4 * error)
    assert error < 0.1 * expected


def test_signal_to_noise_ratio_is_as_stated(short_test: Excitation) -> None:
    """The matched filter of the hidden signal has the mean d and the variance 1 over noise."""
    rng = np.random.Generator(np.random.Philox(4))
    unit = drawn_unit(rng, short_test)
    metric = Metric(short_test, unit.noise)
    hidden = single(rng, short_test, metric, "gyro.g_sensitivity", 6.0)
    assert hidden is not None
    assert metric.signal_to_noise(hidden.signal) == pytest.approx(6.0)
    found = []
    for _ in range(150):
        total = 0.0
        for channel, wave in hidden.signal.items():
            runs = [unit.noise[channel].drawn(rng, run.rows) for run in short_test.runs]
            inner = metric.channels[channel]
            both = inner.whitened(np.stack([wave, wave + np.concatenate(runs)], axis=1))
            total += inner.inner(both[:, :1], both[:, 1:])[0, 0] / 6.0
        found.append(total)
    assert np.mean(found) == pytest.approx(6.0, abs=4 / np.sqrt(150))
    assert np.var(found) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 150))


def test_rates_are_those_of_the_attitude(short_test: Excitation) -> None:
    """R' = R [w x], by central differences; specific force and field have constant lengths."""
    run = short_test.runs[0]
    step = run.t[1] - run.t[0]
    derivative = (run.rotation[2:] - run.rotation[:-2]) / (2 * step)
    skew = np.einsum("nji,njk->nik", run.rotation[1:-1], derivative)
    w = np.rad2deg(np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1))
    assert w == pytest.approx(run.w[1:-1], abs=0.02)
    assert np.linalg.norm(run.f, axis=1) == pytest.approx(1.0)


def test_play_follows_at_its_distance() -> None:
    x = np.sin(np.linspace(0, 9, 400)) + 0.3 * np.sin(np.linspace(0, 40, 400))
    state, walked = x[0], []
    for value in x:
        state = min(max(state, value - 0.2), value + 0.2)
        walked.append(state)
    assert played(x, 0.2) == pytest.approx(np.array(walked))


def test_a_case_is_reproducible_and_in_the_contract_s_form(short_test: Excitation, tmp_path: Path) -> None:
    catalogue = Catalogue(short_test)
    spec = CaseSpec(7, "single", ("acc.quadratic_nonlinearity",), 8.0, "tumble", 0)
    labels = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        case = make_case(spec, 3, short_test, catalogue)
        labels.append(json.dumps(write(case, short_test, 3, tmp_path / name, catalogue), default=float))
    assert labels[0] == labels[1]
    folders = sorted((tmp_path / "one" / "case-00007").iterdir())
    assert len(folders) == len(short_test.runs)
    for folder in folders:
        one, other = (
            read_recording(tmp_path / side / "case-00007" / folder.name) for side in ("one", "other")
        )
        for stream in ("dut", "stand"):
            for column, samples in one.streams[stream].columns.items():
                assert np.array_equal(samples, other.streams[stream].columns[column]), column
    label = json.loads(labels[0])
    assert label["effects"] == ["acc.quadratic_nonlinearity"]
    assert label["d"] == [8.0]


def test_a_number_tells_nothing_and_every_ladder_step_is_there() -> None:
    specs = plan("default", 1)
    assert len(specs) >= 400
    assert {spec.d for spec in specs if spec.kind == "single"} == set(LADDER)
    assert {spec.excitation for spec in specs} == set(KINDS)
    nulls = np.array([spec.number for spec in specs if spec.kind == "null"])
    assert abs(nulls.mean() - len(specs) / 2) < 4 * len(specs) / np.sqrt(12 * len(nulls))


def test_only_the_step_that_calls_the_engine_knows_the_product() -> None:
    for path in Path(__file__).parent.glob("*.py"):
        if path.name == "engine_calls.py" or path.name.startswith("test_"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not PACKAGES & {name.split(".")[0] for name in names}, path.name
