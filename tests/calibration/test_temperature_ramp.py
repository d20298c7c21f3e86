"""Temperature ramps of emulated units and of a closed form: sensitivity, hysteresis, what follows dT/dt."""

import numpy as np
import pytest

from calibration.algorithms.block_means import block_means
from calibration.algorithms.correlated_fit import Blocks
from calibration.algorithms.thermal_ramp import RampFit, fit_ramp
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.evaluations.channels import channels_in_si
from calibration.evaluations.room_matrix import temperature_column
from calibration.evaluations.temperature_ramp import KINDS
from calibration.sensor_knowledge import slow_noise
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white
from tests.calibration.test_method_evaluations import quantity, with_columns

BLOCK_S = 20.0
AMPLITUDE, SPEED_SI = 2e-3, 0.03
LAG_S, PLAY_C = 150.0, 15.0
GRAVITY = 9.8013


def cycle(lag_s: float = LAG_S) -> tuple[np.ndarray, np.ndarray]:
    """Time and sensor temperature: down, up, down at 3 deg C/min with soaks, through a lag."""
    corners_s = np.cumsum([0.0, 1260.0, 900.0, 2200.0, 900.0, 940.0, 900.0])
    air = np.interp(
        np.arange(0.0, corners_s[-1], 1.0), corners_s, [23.0, -40.0, -40.0, 70.0, 70.0, 23.0, 23.0]
    )
    sensor = np.empty_like(air)
    state = 23.0
    for k, one in enumerate(air):
        state += (one - state) / lag_s
        sensor[k] = state
    return np.arange(len(air)) * 1.0, sensor


def place_in_play(temperature_c: np.ndarray) -> np.ndarray:
    """Written out step by step: -1 after a fall of the play's width, +1 after a rise."""
    place, out = 0.0, [0.0]
    for step in np.diff(temperature_c):
        place = min(1.0, max(-1.0, place + step / PLAY_C))
        out.append(place)
    return np.array(out)


def clean() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, temperature and output (m/s^2) after 600 s."""
    time_s, sensor = cycle()
    excess = (sensor - 15.0) / 55.0
    speed = np.gradient(sensor, time_s)
    output = 0.05 * excess + 0.02 * excess**2 - 0.01 * excess**3
    return (
        time_s[600:],
        sensor[600:],
        (output + SPEED_SI * speed + AMPLITUDE * place_in_play(sensor))[600:],
    )


def blocked(time_s: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    count = len(time_s) // int(BLOCK_S)
    return tuple(one[: count * int(BLOCK_S)].reshape(count, -1).mean(axis=1) for one in (time_s, *values))


def mean_difference(place: np.ndarray, temperature_c: np.ndarray) -> float:
    """Place in the play when warming less when cooling, mean over the temperatures."""
    coldest, hottest = int(temperature_c.argmin()), int(temperature_c.argmax())
    grid = np.linspace(temperature_c.min() + 0.5, temperature_c.max() - 0.5, 400)
    warm = np.interp(grid, temperature_c[coldest:hottest], place[coldest:hottest])
    cool = np.concatenate([place[:coldest], place[hottest:]])
    at = np.concatenate([temperature_c[:coldest], temperature_c[hottest:]])
    order = np.argsort(at)
    return float((warm - np.interp(grid, at[order], cool[order])).mean())


def test_a_clean_loop_is_taken_apart() -> None:
    time_s, sensor, output = clean()
    middle_s, temperature_c, mean = blocked(time_s, sensor, output)
    blocks = Blocks(middle_s, np.full(len(middle_s), BLOCK_S), mean[:, None])
    found = fit_ramp(blocks, temperature_c, ())
    assert found.rate_si_s_per_c[0] == pytest.approx(SPEED_SI, rel=0.05)
    difference = mean_difference(place_in_play(cycle()[1])[600:], sensor)
    assert found.hysteresis_si[0] == pytest.approx(AMPLITUDE * difference, rel=0.05)
    assert found.loop_si[:, 0].max() == pytest.approx(2.0 * AMPLITUDE, rel=0.15)
    ends = [(at - 15.0) / 55.0 for at in found.span_c]
    rise = np.diff([0.05 * e + 0.02 * e**2 - 0.01 * e**3 for e in ends])[0] + 2.0 * AMPLITUDE
    assert found.sensitivity_si_per_c[0] == pytest.approx(rise / np.ptp(found.span_c), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["white", "exponential", "flicker"])
def test_two_hundred_loops_are_covered(shape: str) -> None:
    """All 200 are channels of one fit; the truth is the fit of the loop without noise."""
    time_s, sensor, output = clean()
    middle_s, temperature_c, mean = blocked(time_s, sensor, output)
    rng, count, level = np.random.default_rng(3), len(middle_s), 1e-3
    slow = {
        "white": lambda: 0.0,
        "exponential": lambda: exponential(rng, count, 200, level, 300.0, BLOCK_S),
        "flicker": lambda: flicker(rng, count, 200, 0.5 * level, BLOCK_S),
    }[shape]()
    noise = white(rng, count, 200, 1e-6, BLOCK_S) + slow
    lasting = np.full(count, BLOCK_S)
    known = {"white": (), "exponential": ((level, 300.0),), "flicker": None}[shape]
    truth = fit_ramp(Blocks(middle_s, lasting, mean[:, None]), temperature_c, ())
    found = fit_ramp(Blocks(middle_s, lasting, mean[:, None] + noise), temperature_c, known)
    u = np.sqrt(np.einsum("mii->mi", found.covariance))
    check_coverage((_figures(found) - _figures(truth)) / u, less=0.05 if shape == "flicker" else 0.02)
    loop = (found.loop_si - truth.loop_si)[3:-3].T / found.loop_u_si[3:-3].T
    check_coverage(loop, less=0.05 if shape == "flicker" else 0.02)


def _figures(fit: RampFit) -> np.ndarray:
    return np.column_stack([fit.rate_si_s_per_c, fit.hysteresis_si, fit.sensitivity_si_per_c])


def _parameter(effect: object, name: str) -> tuple[float, float, float]:
    return getattr(effect, name)


def _effects(seed: int) -> dict[tuple[str, str], object]:
    """Of a unit of the lot, by sensor and word."""
    twin = product_named("mems_ahrs").twin(seed, "U-0001")
    return {(one.sensor, one.word): one for one in twin.effects}


def _powers(effect: object, name: str, excess_c: float) -> np.ndarray:
    """sum c_k (T - 25)^k, (3,)."""
    coefficients = np.array(getattr(effect, name))
    return sum((row * excess_c ** (k + 1) for k, row in enumerate(coefficients)), np.zeros(3))


def _rise(effects: dict[tuple[str, str], object], kind: str, span_c: tuple[float, float]) -> np.ndarray:
    """Of the output at rest from the coldest to the hottest, (3,), z up: without its play."""
    force = np.array([0.0, 0.0, GRAVITY if kind == "acc" else 0.0])
    at = []
    for excess_c in (span_c[0] - 25.0, span_c[1] - 25.0):
        scale = _powers(effects[kind, "scale_factor_temperature"], "coefficients_per_c", excess_c)
        turned = np.array(_parameter(effects[kind, "misalignment_temperature"], "misalignment_rad_per_c"))
        bias = _powers(effects[kind, "bias_temperature"], "coefficients_si_per_c", excess_c)
        at.append(bias + scale * force + excess_c * turned @ force)
    return at[1] - at[0]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_hundred_emulated_triads_are_covered() -> None:
    """dT/dt of the gyros, hysteresis and sensitivity of both triads against the twins' own parameters.

    Blocks of 40 s, for speed: what changes takes minutes.
    """
    pulls: dict[str, list[np.ndarray]] = {name: [] for name in ("rate", "gyro", "acc")}
    for seed in range(1, 201):
        recording = recorded("mems_ahrs", "temperature_ramp", seed=seed, rate_hz=1.0)
        dut, effects = recording.stream("dut"), _effects(seed)
        used = dut.time_s() >= 600.0
        for kind in KINDS:
            warmth = np.asarray(dut.columns[temperature_column(recording, kind)], dtype=np.float64)
            output = channels_in_si(recording, kind)[1][used]
            means = block_means("ramp", dut.time_s()[used], output, 40.0, inputs=warmth[used, None])
            known = tuple(
                (term.standard_deviation, term.correlation_time_s) for term in slow_noise(recording, kind)
            )
            found = fit_ramp(means.blocks, means.inputs[:, 0], known)
            u = np.sqrt(np.einsum("mii->mi", found.covariance))
            amplitude = np.array(_parameter(effects[kind, "thermal_hysteresis"], "amplitude_si"))
            loop = amplitude * mean_difference(place_in_play(warmth)[used], warmth[used])
            slope = (_rise(effects, kind, found.span_c) + 2.0 * amplitude) / np.ptp(found.span_c)
            off = np.column_stack([found.hysteresis_si - loop, found.sensitivity_si_per_c - slope])
            pulls[kind].append((off / u[:, 1:]).ravel())
            if kind == "gyro":
                truth = _parameter(effects[kind, "temperature_rate"], "coefficient_rad_per_c")
                pulls["rate"].append((found.rate_si_s_per_c - truth) / u[:, 0])
    for each in pulls.values():
        check_coverage(np.array(each))


@pytest.mark.slow
def test_emulated_units_by_the_whole_route() -> None:
    """8 units of the lot: dT/dt of the gyros against their twins; their loops go the right way round."""
    pulls, signs = [], []
    for seed in range(1, 9):
        found = evaluate_by_profile([recorded("mems_ahrs", "temperature_ramp", seed=seed, rate_hz=1.0)])
        effects = _effects(seed)
        for axis, letter in enumerate("xyz"):
            value, u = quantity(found, "gyro", f"temperature_rate_sensitivity_{letter}")
            truth = _parameter(effects["gyro", "temperature_rate"], "coefficient_rad_per_c")[axis]
            pulls.append((value - truth) / u)
            amplitude = _parameter(effects["acc", "thermal_hysteresis"], "amplitude_si")[axis]
            value, u = quantity(found, "acc", f"thermal_hysteresis_{letter}")
            if abs(amplitude) > 3.0 * u:
                signs.append(value / amplitude)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5  # of 24 normal pulls below it: all but one in a thousand
    assert np.abs(pulls).max() < 4.0
    assert len(signs) > 4
    assert 1.1 < np.median(signs) < 2.1  # warming less cooling is twice the amplitude, less at the turns


def test_a_fog_s_shupe_effect_and_what_is_refused() -> None:
    recording = recorded("fog", "temperature_ramp", seed=2)
    found = evaluate_by_profile([recording])
    effects = {one.word: one for one in product_named("fog").twin(2, "U-0001").effects}
    value, u = quantity(found, "gyro", "temperature_rate_sensitivity_z")
    assert value > 5.0 * u
    truth = _parameter(effects["temperature_rate"], "coefficient_rad_per_c")[2]
    assert abs(value - truth) < 3.5 * u
    loop, of_loop = quantity(found, "gyro", "thermal_hysteresis_z")
    assert abs(loop) < 4.0 * of_loop
    with pytest.raises(CalibrationError, match="no temperature of the unit"):
        evaluate_by_profile([with_columns(recording, "dut", temp=None)])
    stuck = np.full(len(recording.stream("dut")), 23.0)
    with pytest.raises(CalibrationError, match=r"spans 0\.0 degC only"):
        evaluate_by_profile([with_columns(recording, "dut", temp=stuck)])
    one_way = np.linspace(-20.0, 60.0, len(stuck))
    with pytest.raises(CalibrationError, match="one way only"):
        evaluate_by_profile([with_columns(recording, "dut", temp=one_way)])
