"""The emulator's speed: the usual effects beside a plain numpy reference, all effects, a stream on the wire.

The reference does what anybody would write down: SFC64, `lfilter` Gauss–Markov, a 3×3 matrix, a constant
bias and white noise, whole arrays, twice (gyros and accelerometers). The usual effects are those, and the
temperature's and a quantiser besides.
"""

import struct
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from dut_emulator.effects import deterministic, stochastic
from dut_emulator.effects.catalogue import CATALOGUE, candidate
from dut_emulator.effects.effect import EffectChain, SensorName, Stimulus
from dut_emulator.effects.parameters import scalars, with_values
from dut_emulator.products.gnc_module import make_unit
from dut_emulator.stands.level_board import LevelBoard
from protocol.bench_description import Site
from protocol.frames import encode_frame
from protocol.gnc_module import START_STREAM_LAYOUT, FrameType

SAMPLES = 1_200_000
RATE_HZ = 1000.0
CHUNK = 16_384
ROUNDS = 5
STREAM_HOURS = 1
RATIO_GOAL = 2.0
SAMPLES_PER_S_GOAL = 1e6
STREAM_S_GOAL = 1.5
EVERY_EFFECT_SAMPLES = 400_000
SMALL_SHARE = 1e-3
"""Of a parameter's range, where an effect is on but a chain of all of them stays sane."""
TRIADS: tuple[SensorName, ...] = ("gyro", "acc")
SANE: dict[str, dict[str, float]] = {
    "saturation": {"range_si": 30.0},
    "counter_wrap": {"half_span_si": 50.0},
    "fixed_delay": {"delay_s": 2e-3},
    "clock_drift": {"relative_rate": 1e-5},
    "timestamp_jitter": {"deviation_s": 1e-5},
    "crank_geometry": {"ratio": 1e-3},
}


def run() -> list[dict[str, Any]]:
    """The figures."""
    emulator_s, reference_s = _fastest(_Usual().run), _fastest(_reference)
    ratio, rate = emulator_s / reference_s, SAMPLES / emulator_s
    own, all_of_them = _EveryEffect(("gyro.", "acc.", "stand.lever_arm")), _EveryEffect(())
    own_rate, full_rate = (EVERY_EFFECT_SAMPLES / _fastest(set_.run) for set_ in (own, all_of_them))
    stream_s = _fastest(_stream)
    return [
        {
            "figure": "usual effects, six-axis samples",
            "value": rate,
            "unit": "1/s",
            "goal": SAMPLES_PER_S_GOAL,
            "met": rate >= SAMPLES_PER_S_GOAL,
            "compared_with": f"plain numpy {SAMPLES / reference_s:,.0f}/s",
        },
        {
            "figure": "usual effects, CPU time over plain numpy's",
            "value": ratio,
            "unit": "1",
            "goal": f"at most {RATIO_GOAL:g}",
            "met": ratio <= RATIO_GOAL,
            "compared_with": f"plain numpy {reference_s:.2f} s",
        },
        {
            "figure": f"all {all_of_them.count} effects of both triads, stand and link, six-axis samples",
            "value": full_rate,
            "unit": "1/s",
            "goal": SAMPLES_PER_S_GOAL,
            "met": full_rate >= SAMPLES_PER_S_GOAL,
            "compared_with": f"without stand and link, {own.count} effects: {own_rate:,.0f}/s",
        },
        {
            "figure": "one hour of a unit's 200 Hz stream, as frames",
            "value": stream_s,
            "unit": "s",
            "goal": f"at most {STREAM_S_GOAL:g}",
            "met": stream_s <= STREAM_S_GOAL,
            "compared_with": "",
        },
    ]


def _fastest(task: Callable[[], None], rounds: int = ROUNDS) -> float:
    """Least CPU time of some rounds."""
    durations = []
    for _ in range(rounds):
        began = time.process_time()
        task()
        durations.append(time.process_time() - began)
    return min(durations)


class _Usual:
    """Matrix, bias, white noise, slow noise, temperature and quantiser of both triads."""

    def __init__(self) -> None:
        off = ((0.0, 0.01, -0.01), (0.01, 0.0, 0.01), (-0.01, 0.01, 0.0))
        self._chains = [
            EffectChain(
                (
                    deterministic.Misalignment(sensor, off),
                    deterministic.ScaleFactorError(sensor, (0.01, 0.01, 0.01)),
                    deterministic.Bias(sensor, (0.1, 0.2, 0.3)),
                    deterministic.BiasTemperature(sensor, ((1e-4, 2e-4, 3e-4), (1e-6, 2e-6, 3e-6))),
                    stochastic.WhiteNoise(sensor, (1e-3, 1e-3, 1e-3)),
                    stochastic.BiasInstability(sensor, (1e-4, 1e-4, 1e-4), 300.0),
                    deterministic.Quantisation(sensor, 1e-4),
                )
            )
            for sensor in TRIADS
        ]

    def run(self) -> None:
        memories = [chain.begin(np.random.SeedSequence(number)) for number, chain in enumerate(self._chains)]
        for begin in range(0, SAMPLES, CHUNK):
            count = min(CHUNK, SAMPLES - begin)
            instants = np.arange(begin, begin + count, dtype=np.float64) / RATE_HZ
            stimulus = Stimulus(instants, 25.0 + 1e-3 * instants, 1 / RATE_HZ)
            for chain, memory in zip(self._chains, memories, strict=True):
                chain.apply(np.ones((count, 3)), stimulus, memory)


class _EveryEffect:
    """Both triads with everything that may act on them at once, in a motion that turns and shakes.

    `beginnings`: of the names of the effects; none for all.
    """

    def __init__(self, beginnings: tuple[str, ...]) -> None:
        self._beginnings = beginnings
        self._chains = [EffectChain(self._effects(sensor)) for sensor in TRIADS]
        self.count = sum(len(chain.effects) for chain in self._chains)
        instants = np.arange(EVERY_EFFECT_SAMPLES, dtype=np.float64) / RATE_HZ
        waves = np.stack([np.sin(2 * np.pi * f * instants) for f in (0.3, 0.7, 1.9)], axis=1)
        self._chunks = [
            Stimulus(
                instants[chunk],
                25 + 20 * waves[chunk, 0],
                1 / RATE_HZ,
                rate_rad_s=2 * waves[chunk],
                specific_force_m_s2=9.8 * waves[chunk, ::-1],
                field_t=3e-5 * waves[chunk],
                supply_v=5 + 0.1 * waves[chunk, 1],
                angles_rad=3 * waves[chunk],
                earth_rate_rad_s=7e-5 * waves[chunk],
            )
            for chunk in (slice(begin, begin + CHUNK) for begin in range(0, EVERY_EFFECT_SAMPLES, CHUNK))
        ]

    def _effects(self, sensor: SensorName) -> list[Any]:
        return [
            _turned_on(candidate(name, sensor))
            for name, (_, sensors) in CATALOGUE.items()
            if sensor in sensors
            and name.startswith(self._beginnings or name)
            and not name.endswith("flicker_noise")  # bias instability has two forms: one at a time
        ]

    def run(self) -> None:
        memories = [chain.begin(np.random.SeedSequence(number)) for number, chain in enumerate(self._chains)]
        for chunk in self._chunks:
            stimulus = replace(chunk)  # nothing that an earlier round has worked out
            for sensor, chain, memory in zip(TRIADS, self._chains, memories, strict=True):
                chain.apply(stimulus.true_input(sensor), stimulus, memory)


def _turned_on(effect: Any) -> Any:
    free = {
        scalar.name: SMALL_SHARE * min(scalar.high, 1e4)
        for scalar in scalars(effect, free_only=True)
        if scalar.value != np.inf
    }
    return with_values(effect, free | SANE.get(effect.word, {}))


def _reference() -> None:
    rng = np.random.Generator(np.random.SFC64(1))
    matrix, bias = np.eye(3) + 0.01, np.array([0.1, 0.2, 0.3])
    phi = np.exp(-1 / RATE_HZ / 300.0)
    for _ in range(2):
        samples = np.ones((SAMPLES, 3)) @ matrix.T + bias
        samples += 1e-3 * rng.standard_normal(samples.shape)
        drive = 1e-4 * np.sqrt(1 - phi**2) * rng.standard_normal(samples.shape)
        samples += lfilter([1.0], [1.0, -phi], drive, axis=0)


def _stream() -> None:
    unit = make_unit(1, "BENCH-1")
    unit.insert(LevelBoard(Site(latitude_deg=34.2, gravity_m_s2=9.797)), 0.0)
    unit.set_supply(5.0, 0.0)
    unit.advance(2.0)
    start = START_STREAM_LAYOUT.pack(200, 0)
    unit.receive("rs422", encode_frame(FrameType.START_STREAM, 1, start), 2.0)
    received = sum(len(output.data) for output in unit.advance(2.0 + 3600.0 * STREAM_HOURS))
    assert received > 3600 * STREAM_HOURS * 200 * struct.calcsize("<I")
