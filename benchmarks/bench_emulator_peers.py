"""The emulator beside imu-error-model and allantools, and the memory that a long recording takes.

imu-error-model (MIT) takes one sample at a time, so it gets a short stretch; ours has the same effects on, in
chunks as a recording makes them. The peer also differentiates velocity and attitude, which ours gets ready
made; one at a time, ours may be the slower of the two: its time so is printed beside it.
"""

import subprocess
import sys
import time
from typing import Any

import allantools
import imu_error_model
import numpy as np

from dut_emulator.effects import deterministic, nonlinearity, slow_noise, stochastic, thermal
from dut_emulator.effects.effect import EffectChain, EffectState, SensorName, Stimulus

PEER_SAMPLES = 4_000
SAMPLES = 400_000
CHUNK = 16_384
PERIOD_S = 1e-3
ONE_BY_ONE_SAMPLES = 400
FLAT_PERIOD_S, FLAT_SAMPLES = 0.1, 400_000
FLAT_SPANS_S = (30.0, 60.0, 120.0, 240.0)
FLAT_OVER_B = 0.6643
"""√(2 ln 2 / π), IEEE 952."""
FLAT_TOLERANCE = 0.05
KILOBYTES_IN_A_MEGABYTE = 1024.0
MEMORY_GOAL_MB = 64.0
RECORDED_S = 3600.0
MICROSECONDS_IN_A_SECOND = 1e6


def run() -> list[dict[str, Any]]:
    """The figures."""
    peer_rate, own_rate, one_by_one = (
        _rate_of_the_peer(),
        _own_rate(SAMPLES, CHUNK),
        _own_rate(ONE_BY_ONE_SAMPLES, 1),
    )
    flat = _flat_of_flicker_noise()
    (before_mb, peak_mb), recording_s = _memory_mb_and_s(RECORDED_S)
    return [
        {
            "figure": "the effects of imu-error-model, six-axis samples, over its own",
            "value": own_rate / peer_rate,
            "unit": "1",
            "goal": "faster than the peer",
            "met": own_rate > peer_rate,
            "compared_with": f"CPU time of a sample: {_microseconds(own_rate)} in chunks of {CHUNK:,}, "
            f"{_microseconds(one_by_one)} one by one; imu-error-model 0.1.3 {_microseconds(peer_rate)}",
        },
        {
            "figure": "flat of flicker noise by allantools, over B",
            "value": flat,
            "unit": "1",
            "goal": f"{FLAT_OVER_B:g} ± {FLAT_TOLERANCE:.0%}",
            "met": abs(flat / FLAT_OVER_B - 1) <= FLAT_TOLERANCE,
            "compared_with": f"IEEE 952: {FLAT_OVER_B:g}",
        },
        {
            "figure": "an hour at 1 kHz, six axes and more, recorded as float32: peak memory above the start",
            "value": peak_mb - before_mb,
            "unit": "MB",
            "goal": f"at most {MEMORY_GOAL_MB:g}",
            "met": peak_mb - before_mb <= MEMORY_GOAL_MB,
            "compared_with": f"{peak_mb:.0f} MB in all; {recording_s:.0f} s of CPU time",
        },
    ]


def _rate_of_the_peer() -> float:
    """Six-axis samples per CPU second."""
    axis: dict[str, Any] = {
        "white_noise_density": 1e-3,
        "turn_on_bias_std": 1e-3,
        "bias_std": 1e-4,
        "bias_correlation_time": 300.0,
        "flicker_bias_std": 1e-4,
        "flicker_min_correlation_time": 0.1,
        "flicker_max_correlation_time": 6553.6,
        "flicker_components": 9,
        "scale_factor": 1e-3,
        "nonlinear_factor": 1e-5,
        "misalignment_std": 1e-3,
        "measurement_range": 100.0,
        "quantization_step": 1e-5,
        "thermal_bias_coefficient": 1e-4,
        "thermal_scale_factor_coefficient": 1e-5,
    }
    config = imu_error_model.AxisConfig(**axis)
    model = imu_error_model.ImuModel(
        imu_error_model.ImuConfig(accelerometer=config, gyroscope=config), np.random.default_rng(1)
    )
    level, still = np.eye(3), np.zeros(3)
    began = time.process_time()
    for number in range(PEER_SAMPLES):
        model.measure(number * PERIOD_S, still, level, 30.0)
    return PEER_SAMPLES / (time.process_time() - began)


def _own_rate(samples: int, chunk: int) -> float:
    """Six-axis samples per CPU second, the fastest of three rounds."""
    sensors: tuple[SensorName, ...] = ("gyro", "acc")
    chains = [EffectChain(_peers_effects(sensor)) for sensor in sensors]
    durations = []
    for _ in range(3):
        began = time.process_time()
        memories = [chain.begin(np.random.SeedSequence(1)) for chain in chains]
        for begin in range(0, samples, chunk):
            count = min(chunk, samples - begin)
            instants = np.arange(begin, begin + count, dtype=np.float64) * PERIOD_S
            stimulus = Stimulus(instants, np.full(count, 30.0), PERIOD_S)
            for chain, memory in zip(chains, memories, strict=True):
                chain.apply(np.zeros((count, 3)), stimulus, memory)
        durations.append(time.process_time() - began)
    return samples / min(durations)


def _microseconds(samples_per_s: float) -> str:
    return f"{MICROSECONDS_IN_A_SECOND / samples_per_s:.3g} µs"


def _peers_effects(sensor: SensorName) -> tuple[Any, ...]:
    """Every effect that imu-error-model has, here for either triad."""
    small = (1e-3, 1e-3, 1e-3)
    off = ((0.0, 1e-3, 1e-3), (1e-3, 0.0, 1e-3), (1e-3, 1e-3, 0.0))
    square = nonlinearity.EvenNonlinearity if sensor == "gyro" else nonlinearity.QuadraticNonlinearity
    return (
        deterministic.Misalignment(sensor, off),
        deterministic.ScaleFactorError(sensor, small),
        deterministic.Bias(sensor, small),
        deterministic.BiasTemperature(sensor, ((1e-4, 1e-4, 1e-4),)),
        thermal.ScaleFactorTemperature(sensor, ((1e-5, 1e-5, 1e-5),)),
        square(sensor, (1e-5, 1e-5, 1e-5)),
        stochastic.WhiteNoise(sensor, small),
        stochastic.BiasInstability(sensor, (1e-4, 1e-4, 1e-4), 300.0),
        slow_noise.FlickerNoise(sensor, (1e-4, 1e-4, 1e-4)),
        deterministic.Saturation(sensor, 100.0),
        deterministic.Quantisation(sensor, 1e-5),
    )


def _flat_of_flicker_noise() -> float:
    """Mean Allan deviation over the spans where it is flat, over B; by allantools."""
    effect = slow_noise.FlickerNoise("gyro", (1.0, 1.0, 1.0), 0.4, 26_214.4)
    instants = np.arange(FLAT_SAMPLES, dtype=np.float64) * FLAT_PERIOD_S
    stimulus = Stimulus(instants, np.zeros(FLAT_SAMPLES), FLAT_PERIOD_S)
    rng = np.random.Generator(np.random.SFC64(1))
    noise = effect.apply(np.zeros((FLAT_SAMPLES, 3)), stimulus, rng, EffectState())
    deviations = [
        allantools.oadev(noise[:, axis], 1 / FLAT_PERIOD_S, data_type="freq", taus=list(FLAT_SPANS_S))[1]
        for axis in range(3)
    ]
    return float(np.sqrt(np.mean(np.square(deviations))))


_RECORD = r"""
import re, sys, time
from pathlib import Path
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession, record_to

class Nowhere:
    rows = 0

    def append(self, stream, columns):
        self.rows += len(columns["t"]) if stream == "dut" else 0

def session(duration_s):
    values = {"duration_s": duration_s}
    return RecordingSession(
        RecordingOrder("gnc_module", "static", values=values, rate_hz=1000.0, sample_type="float32")
    )

def memory_kb(which):
    return int(re.search(which + r":\s*(\d+) kB", Path("/proc/self/status").read_text())[1])

record_to(session(2.0), [Nowhere()])
before_kb, began = memory_kb("VmRSS"), time.process_time()
writer, duration_s = Nowhere(), float(sys.argv[1])
record_to(session(duration_s), [writer])
assert writer.rows >= duration_s * 999
print(before_kb, memory_kb("VmHWM"), time.process_time() - began)
"""


def _memory_mb_and_s(duration_s: float) -> tuple[tuple[float, float], float]:
    """Resident memory before a process records for so long, and its largest; CPU time of the recording.

    Before: everything is loaded and two seconds have been recorded.
    """
    ended = subprocess.run(
        [sys.executable, "-c", _RECORD, str(duration_s)], check=True, capture_output=True, text=True
    )
    before_kb, peak_kb, cpu_s = (float(word) for word in ended.stdout.split())
    return (before_kb / KILOBYTES_IN_A_MEGABYTE, peak_kb / KILOBYTES_IN_A_MEGABYTE), cpu_s
