"""Observations made by hand: y = u + a x + noise of an exact covariance, no part of the emulator's noise.

Slow noise comes from a circulant embedding by FFT, white noise from numpy's Philox.
"""

import numpy as np

from dut_emulator.effects.effect import Stimulus
from gap_diagnosis.observation import NoiseBelief, Observation, SensorOutput

DEG = np.pi / 180
PERIOD_S = 1.0
WHITE, SLOW, TAU_S = 0.01 * DEG, 0.004 * DEG, 100.0
BELIEF = NoiseBelief(
    white_si_per_sqrt_hz=WHITE * np.sqrt(PERIOD_S),
    white_spread=0.3,
    slow_deviation_si=SLOW,
    slow_correlation_time_s=TAU_S,
    slow_spread=0.3,
)


def gauss_markov(rng, count, deviation, tau_s, period_s=PERIOD_S):
    """(count,) of the autocovariance deviation² exp(−|t|/tau)."""
    lags = np.arange(count)
    half = deviation**2 * np.exp(-lags * period_s / tau_s)
    power = np.maximum(np.fft.fft(np.r_[half, half[-2:0:-1]]).real, 0.0)
    size = len(power)
    waves = np.sqrt(power / size) * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
    return np.fft.fft(waves).real[:count]


def motion(seconds, *, still=False, seed=3):
    """A gyro triad's test: steps of rate on each axis, gravity turned, the chamber up and down."""
    rng = np.random.Generator(np.random.Philox(seed))
    time_s = np.arange(0.0, seconds, PERIOD_S)
    count = len(time_s)
    steps = np.repeat(rng.uniform(-3.0, 3.0, (count // 20 + 1, 3)), 20, axis=0)[:count]
    tilts = np.repeat(rng.standard_normal((count // 37 + 1, 3)), 37, axis=0)[:count]
    forces = 9.8 * tilts / np.linalg.norm(tilts, axis=1, keepdims=True)
    temperature = 25.0 + 20.0 * np.sin(2 * np.pi * time_s / seconds)
    if still:
        steps, forces, temperature = 0.0 * steps, np.tile([0.0, 0.0, 9.8], (count, 1)), 25.0 + 0.0 * time_s
    return Stimulus(
        time_s=time_s,
        temperature_c=temperature,
        sample_period_s=PERIOD_S,
        rate_rad_s=steps,
        specific_force_m_s2=forces,
    )


def observed(rng, stimulus, added_si=0.0, *, run="1", mount="m1", slow=SLOW, belief=BELIEF):
    """One recording of a gyro: noise at the believed levels and whatever is added, (n, 3)."""
    count = len(stimulus.time_s)
    noise = np.stack(
        [WHITE * rng.standard_normal(count) + gauss_markov(rng, count, slow, TAU_S) for _ in range(3)], axis=1
    )
    scale = np.eye(3) + 3e-4 * generator(sum(mount.encode())).standard_normal((3, 3))  # of the mount
    bias = 0.1 * DEG * rng.standard_normal(3)
    return Observation(
        recording_id=f"made-{run}",
        serial="U-1",
        product="mems_imu",
        profile="made",
        run=run,
        mount=mount,
        stand_id="",
        stand_kind="",
        stimulus=stimulus,
        has_temperature=True,
        outputs={
            "gyro": SensorOutput(
                stimulus.rate_rad_s @ scale.T + bias + added_si + noise, stimulus.rate_rad_s, belief
            )
        },
        usable=np.ones(count, dtype=bool),
        piece=np.zeros(count, dtype=np.int64),
        sample_period_s=PERIOD_S,
    )


def generator(seed):
    return np.random.Generator(np.random.Philox(seed))
