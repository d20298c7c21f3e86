"""Temperature compensation and warm-ups of the emulator, and warm-ups in coloured noise: intervals hold."""

import numpy as np
import pytest

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.thermal_network import PASTE, ThermalNetwork, WarmUp, fit_thermal_network
from calibration.algorithms.thermal_soaks import SoakReadings, fit_soaks
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.products.mems_ahrs.thermal_network import ThermalNetwork as Housing
from dut_emulator.products.mems_ahrs.thermal_network import ThermalState
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white
from tests.calibration.test_temperature_positions import _soaks, followed, pulls
from tests.calibration.test_thermal_network import CAPACITY, CONDUCTANCE, EDGES, NODES, POWER, warm_up

ROOM_C = 27.0
STEP_S, STEPS = 5.0, 2900
MOUNTS = {"acc": 2, "gyro": 3}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["acc", "gyro"])
def test_two_hundred_units_are_covered_in_their_own_noise(kind: str) -> None:
    """Positions at seven soaks, seen through the unit's own chain of white noise and bias instability."""
    room = TriadCoefficients("acceleration", np.eye(3), np.zeros(3), np.zeros((12, 12)), 0.0, 0)
    found: list[np.ndarray] = []
    stimulus = Stimulus(STEP_S * np.arange(STEPS, dtype=np.float64), np.full(STEPS, 25.0), STEP_S)
    for seed in range(1, 201):
        twin = followed(seed)
        clean, temperature, pose, time_s = _soaks(twin, kind, MOUNTS[kind], 7)
        random = [one for one in twin.effects if one.sensor == kind]
        random = [one for one in random if isinstance(one, WhiteNoise | BiasInstability)]
        (slow,) = [one for one in random if isinstance(one, BiasInstability)]
        chain, seen = EffectChain(random), clean.copy()
        for mount in range(MOUNTS[kind]):
            rows = np.flatnonzero(time_s // 1e7 == mount)
            at = ((time_s[rows] - mount * 1e7) / STEP_S).astype(int)
            memory = chain.begin(np.random.SeedSequence([seed, mount]))
            seen[rows] += chain.apply(np.zeros((STEPS, 3)), stimulus, memory)[at]
        readings = SoakReadings(seen, temperature, pose, time_s, np.full(len(clean), STEP_S))
        # of the product: the root mean square over units and axes
        known = float(np.sqrt(np.mean(np.square(slow.standard_deviation_si))))
        terms = ((known, float(slow.correlation_time_s)),)
        found.append(pulls(fit_soaks(readings, room, ROOM_C, terms).model, twin, kind, ROOM_C))
    check_coverage(np.array(found), less=0.04, more=0.2)


def pulls_of(found: ThermalNetwork, capacity: np.ndarray, conductance: np.ndarray) -> np.ndarray:
    """Of ln C and ln G."""
    off = np.log(np.concatenate([found.capacity_j_k / capacity, found.conductance_w_k / conductance]))
    return off / np.sqrt(np.diag(found.log_covariance))


REDUCED = Housing(dict(zip(NODES, CAPACITY, strict=True)), dict(zip(EDGES, CONDUCTANCE[PASTE], strict=True)))
"""As many nodes as thermocouples: of a housing with more, rises and settling time hold, C and G do not."""


@pytest.mark.slow
def test_two_hundred_warm_ups_of_the_emulators_model_are_covered() -> None:
    """The emulator's thermal network with three nodes: C and G of the same network are the truth."""
    step_s, count = 20.0, 90
    clean = ThermalState(REDUCED, 70.0).advance(np.full(count, 70.0), step_s, POWER)
    found: list[np.ndarray] = []
    for seed in range(200):
        noisy = clean + np.random.default_rng(seed).normal(0.0, 0.02, clean.shape)
        warm = WarmUp(step_s * np.arange(1, count + 1, dtype=np.float64), noisy, POWER, 70.0)
        fitted = fit_thermal_network([warm], NODES, EDGES)
        found.append(pulls_of(fitted, CAPACITY, CONDUCTANCE[PASTE]))
    check_coverage(np.array(found))


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["exponential", "flicker"])
def test_warm_ups_are_covered_on_coloured_noise(colour: str) -> None:
    """Thermocouples whose reference junction wanders beside their white noise."""
    clean = warm_up(PASTE)
    count, step_s = len(clean.time_s), float(clean.time_s[1] - clean.time_s[0])
    found: list[np.ndarray] = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = white(rng, count, 3, 0.01**2 * step_s, step_s)
        if colour == "exponential":
            noise += exponential(rng, count, 3, 0.01, 60.0, step_s)
        else:
            wander = flicker(rng, count, 3, 0.006, step_s)
            noise += wander - wander.mean(axis=0)
        warm = WarmUp(clean.time_s, clean.temperature_c + noise, POWER, 70.0)
        found.append(pulls_of(fit_thermal_network([warm], NODES, EDGES), CAPACITY, CONDUCTANCE[PASTE]))
    check_coverage(np.array(found), less=0.04, more=0.2)
