"""Repeatability over power-ons: 68 and 95 % intervals hold what the turn-ons differ by.

The recorder draws the turn-on bias anew in each run. A scale factor does not change with a unit's power-on
there, so each run gets a chain of effects, or a staircase, whose scale factors are drawn anew.

Rests at 10 Hz: at 1 Hz the accelerometers' white noise is a fifth of their quantum, and means stick to
quanta: intervals have to be wider then, and are.
"""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from calibration.algorithms.bias_figures import TrueInput
from calibration.algorithms.repeatability import Repeatability, bias_repeatability, repeatability
from calibration.algorithms.scale_factor_figures import staircase_figures
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.evaluations.channels import SI, channels_in_si
from calibration.records.record import COVERAGE_PROBABILITY
from dut_emulator.effects.deterministic import ScaleFactorError
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.products.catalogue import product_named
from dut_emulator.products.gnc_module.population import ACC_TURN_ON_SI, GYRO_TURN_ON_SI
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import Twin
from protocol.recordings import Recording
from tests.calibration.test_method_evaluations import quantity
from tests.calibration.test_scale_factor_figures import MATRIX, staircase

UNITS, RUNS = 200, 6
DURATION_S = 601.0
TURN_ON_SI = {"gyro": GYRO_TURN_ON_SI, "acc": ACC_TURN_ON_SI}
KEPT = {"bias", "scale_factor_error", "misalignment", "white_noise", "bias_instability"}


def units(count: int) -> list[tuple[str, Twin]]:
    """Without defect and what a run's mean would see besides: temperature."""
    product = product_named("gnc_module")
    serials = (f"R-{number}" for number in itertools.count() if not product.defects(1, f"R-{number}"))
    return [
        (serial, dataclasses.replace(whole, effects=tuple(e for e in whole.effects if e.word in KEPT)))
        for serial in itertools.islice(serials, count)
        for whole in [product.twin(1, serial)]
    ]


def static_run(serial: str, twin: Twin, run: int, rate_hz: float = 10.0) -> Recording:
    return recorded(
        "gnc_module",
        "static",
        twin=twin,
        serial=serial,
        run=run,
        values={"duration_s": DURATION_S},
        rate_hz=rate_hz,
        started_at=f"2026-01-01T{run:02}:00:00+00:00",
    )


def expected_spread(twin: Twin, kind: str) -> np.ndarray:
    """Of a run's mean, (3,): the turn-on's, white noise N^2 / T, the mean of a Gauss-Markov process."""
    own = {(one.sensor, one.word): one for one in twin.effects}
    noise, slow = own[kind, "white_noise"], own[kind, "bias_instability"]
    assert isinstance(noise, WhiteNoise)
    assert isinstance(slow, BiasInstability)
    white = np.array(noise.density_si_per_sqrt_hz)
    ratio = DURATION_S / slow.correlation_time_s
    of_mean = 2.0 / ratio * (1.0 - (1.0 - math.exp(-ratio)) / ratio)
    variance = white**2 / DURATION_S + np.square(slow.standard_deviation_si) * of_mean
    return np.sqrt(variance + TURN_ON_SI[kind] ** 2)


def check_intervals(found: Repeatability, expected: np.ndarray) -> None:
    count = len(expected)
    for probability in (0.6827, 0.95):
        low, high = found.interval(probability).T
        covered = float(np.mean((low < expected) & (expected < high)))
        margin = 3.5 * math.sqrt(probability * (1.0 - probability) / count)
        assert abs(covered - probability) < margin, (probability, covered)
    # the mean of s^2 is the variance itself: a spread that is wrong by a tenth is seen
    ratio = float(np.mean((found.repeatability / expected) ** 2))
    assert abs(ratio - 1.0) < 3.5 * math.sqrt(2.0 / (RUNS - 1) / count)


def of_all(found: list[Repeatability]) -> Repeatability:
    """Of many units as one of many channels."""
    return dataclasses.replace(
        found[0],
        repeatability=np.concatenate([one.repeatability for one in found]),
        of_quantum=np.concatenate([one.of_quantum for one in found]),
    )


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_turn_on_biases_of_emulated_units_are_covered() -> None:
    """Each unit's six runs of ten minutes; the first one's by the whole route: the same numbers."""
    nothing = TrueInput(np.zeros(3), np.zeros(3), "the same in all runs: no spread")
    spreads: dict[str, list[Repeatability]] = {kind: [] for kind in SI}
    lot = units(UNITS)
    for serial, twin in lot:
        recordings = [static_run(serial, twin, run) for run in range(1, RUNS + 1)]
        for kind in SI:
            runs = [(one.stream("dut").time_s(), channels_in_si(one, kind)[1]) for one in recordings]
            spreads[kind].append(bias_repeatability(runs, nothing, "each_power_on")[0])
        if len(spreads["gyro"]) == 1:
            whole = evaluate_by_profile(recordings)
            for kind, letter in itertools.product(SI, "xyz"):
                value, _ = quantity(whole, kind, f"turn_on_bias_repeatability_{letter}")
                assert value == pytest.approx(spreads[kind][0].repeatability["xyz".index(letter)], rel=1e-9)
    for kind, found in spreads.items():
        together = of_all(found)
        check_intervals(together, np.concatenate([expected_spread(twin, kind) for _, twin in lot]))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_turn_ons_hidden_by_a_quantum_are_covered() -> None:
    """Accelerometers at 1 Hz by the whole route: their turn-ons differ by a twelfth of a quantum."""
    covered: list[bool] = []
    for serial, twin in units(40):
        whole = evaluate_by_profile(
            [static_run(serial, twin, run, rate_hz=1.0) for run in range(1, RUNS + 1)]
        )
        assert sum("hardly blurs its quantum" in words for words in whole.assumptions) == 3
        (told,) = [
            {one.name: one for one in result.content.quantities}
            for result in whole.results
            if result.sensor == "acc" and result.content.method == "repeatability"
        ]
        for letter, expected in zip("xyz", expected_spread(twin, "acc"), strict=True):
            interval = told[f"turn_on_bias_repeatability_{letter}"].interval
            assert interval is not None
            covered.append(interval.lower < expected < interval.upper)
    assert np.mean(covered) > COVERAGE_PROBABILITY - 3.5 * math.sqrt(0.05 * 0.95 / len(covered))


@pytest.mark.slow
def test_turn_on_scale_factors_of_emulated_chains_are_covered() -> None:
    """200 triads, six power-ons each: dwells of 5 s at +-1, 2 and 3 rad/s; noise is a small part of it."""
    spread, density, period_s = 3e-5, 1e-4, 0.02
    rate = np.repeat([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0], 250)
    times_s = period_s * np.arange(len(rate), dtype=np.float64)
    stimulus = Stimulus(times_s, np.full(len(rate), 25.0), period_s)
    of_noise = density / math.sqrt(period_s * float(rate @ rate))
    rng = np.random.default_rng(7)
    noise = WhiteNoise("gyro", density_si_per_sqrt_hz=(density, density, density))
    values = np.empty((RUNS, 3 * UNITS))
    for unit, run in itertools.product(range(UNITS), range(RUNS)):
        x, y, z = (1e-3 + spread * float(one) for one in rng.standard_normal(3))
        chain = EffectChain((ScaleFactorError("gyro", (x, y, z)), noise))
        memory = chain.begin(np.random.SeedSequence([unit, run]))
        output = chain.apply(np.repeat(rate[:, None], 3, axis=1), stimulus, memory)
        values[run, 3 * unit : 3 * unit + 3] = rate @ output / float(rate @ rate) - 1.0
    found = repeatability(values, np.full_like(values, of_noise), "each_power_on")
    check_intervals(found, np.full(3 * UNITS, math.hypot(spread, of_noise)))
    beyond = float(np.sqrt(np.mean(found.beyond_noise**2)))
    assert beyond == pytest.approx(spread, rel=0.08)


@pytest.mark.slow
def test_turn_on_scale_factors_are_covered_on_coloured_noise() -> None:
    """201 axes, six staircases each, in a wander of 100 s whose share is as large as the turn-ons'."""
    spread, sigma, units = 3e-5, 3e-4, UNITS // 3 + 1
    drawn = spread * np.random.default_rng(8).standard_normal((units, RUNS, 3))
    found: list[Repeatability] = []
    noise: list[np.ndarray] = []
    told: list[np.ndarray] = []
    for unit in range(units):
        values, doubt = np.empty((RUNS, 3)), np.empty((RUNS, 3))
        for run, turn_on in enumerate(drawn[unit]):
            dwells = [
                dataclasses.replace(one, output_rad_s=one.output_rad_s + one.rate_body_rad_s * turn_on)
                for one in staircase(RUNS * unit + run, sigma=sigma)
            ]
            axes = staircase_figures(dwells, known_slow=((sigma, 100.0),)).axes
            values[run], doubt[run] = np.transpose([axis.scale_factor_error for axis in axes])
        noise.append(values - (np.diag(MATRIX) - 1.0) - drawn[unit])
        told.append(doubt)
        found.append(repeatability(values, doubt, "each_power_on"))
    of_noise = float(np.std(noise))
    assert 0.5 * spread < of_noise < 2.0 * spread
    together = of_all(found)
    check_intervals(together, np.full(3 * units, math.hypot(spread, of_noise)))
    # what each run says of its own noise, taken away, leaves what the turn-ons differ by
    beyond = np.mean([one.repeatability**2 for one in found]) - np.mean(np.square(told))
    assert beyond == pytest.approx(spread**2, rel=3.5 * 2.0 * math.sqrt(2.0 / (RUNS - 1) / (3 * units)))
