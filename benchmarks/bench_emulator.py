"""The emulator's speed: the usual effects beside a plain numpy reference, and a stream on the wire.

The reference does what anybody would write down: SFC64, `lfilter` Gauss–Markov, a 3×3 matrix, a constant
bias and white noise, whole arrays, twice (gyros and accelerometers).
"""

import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from dut_emulator.effects.catalogue import CATALOGUE, candidate
from dut_emulator.effects.effect import EffectChain, SensorName, Stimulus
from dut_emulator.effects.parameters import scalars, with_values
from dut_emulator.products.gnc_module import make_unit
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_twin import twin_of
from dut_emulator.stands.level_board import LevelBoard
from protocol.bench_description import Site
from protocol.frames import encode_frame
from protocol.gnc_module import START_STREAM_LAYOUT, FrameType

SAMPLES = 1_200_000
RATE_HZ = 1000.0
CHUNK = 16_384
ROUNDS = 3
STREAM_HOURS = 1
RATIO_GOAL = 2.0
SAMPLES_PER_S_GOAL = 1e6
STREAM_S_GOAL = 2.0
EVERY_EFFECT_SAMPLES = 400_000
SMALL_SHARE = 1e-3
"""Of a parameter's range, where an effect is on but a chain of all of them stays sane."""


def run() -> list[dict[str, Any]]:
    """The figures."""
    emulator_s, reference_s = _fastest(_emulator), _fastest(_reference)
    stream_s = _fastest(_stream)
    every_effect = _EveryEffect()
    every_rate = EVERY_EFFECT_SAMPLES / _fastest(every_effect.run)
    ratio = emulator_s / reference_s
    rate = SAMPLES / emulator_s
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
            "figure": f"all {every_effect.count} gyro and accelerometer effects, six-axis samples",
            "value": every_rate,
            "unit": "1/s",
            "goal": SAMPLES_PER_S_GOAL,
            "met": every_rate >= SAMPLES_PER_S_GOAL,
            "compared_with": "",
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


def _emulator() -> None:
    twin = twin_of(draw_unit(1, "BENCH-1"))
    chains = [
        EffectChain(effect for effect in twin.effects if effect.sensor == sensor and effect.origin == "")
        for sensor in ("gyro", "acc")
    ]
    memories = [chain.begin(np.random.SeedSequence(number)) for number, chain in enumerate(chains)]
    for begin in range(0, SAMPLES, CHUNK):
        count = min(CHUNK, SAMPLES - begin)
        instants = (begin + np.arange(count)) / RATE_HZ
        stimulus = Stimulus(instants, np.full(count, 25.0), 1 / RATE_HZ)
        for chain, memory in zip(chains, memories, strict=True):
            chain.apply(np.ones((count, 3)), stimulus, memory)


class _EveryEffect:
    """Both triads with everything that may act on them at once, in a motion that turns and shakes."""

    def __init__(self) -> None:
        self._chains = [(sensor, EffectChain(self._effects(sensor))) for sensor in ("gyro", "acc")]
        self.count = sum(len(chain.effects) for _, chain in self._chains)
        instants = np.arange(EVERY_EFFECT_SAMPLES) / RATE_HZ
        waves = np.stack([np.sin(2 * np.pi * f * instants) for f in (0.3, 0.7, 1.9)], axis=1)
        chunks = [slice(begin, begin + CHUNK) for begin in range(0, EVERY_EFFECT_SAMPLES, CHUNK)]
        self._stimuli = [
            Stimulus(
                instants[chunk],
                25 + 20 * waves[chunk, 0],
                1 / RATE_HZ,
                rate_rad_s=2 * waves[chunk],
                specific_force_m_s2=9.8 * waves[chunk, ::-1],
                field_t=3e-5 * waves[chunk],
                supply_v=5 + 0.1 * waves[chunk, 1],
            )
            for chunk in chunks
        ]

    def _effects(self, sensor: SensorName) -> list[Any]:
        names = [
            name for name in CATALOGUE if name.startswith(f"{sensor}.") and not name.endswith("flicker_noise")
        ]  # bias instability has two forms: one at a time
        effects: list[Any] = [candidate(name) for name in names]
        return [
            with_values(
                effect,
                {
                    s.name: SMALL_SHARE * min(s.high, 1e4)
                    for s in scalars(effect, free_only=True)
                    if s.value != np.inf
                }
                | ({"range_si": 30.0} if effect.word == "saturation" else {}),
            )
            for effect in effects
        ]

    def run(self) -> None:
        for number, (sensor, chain) in enumerate(self._chains):
            memory = chain.begin(np.random.SeedSequence(number))
            for stimulus in self._stimuli:
                chain.apply(stimulus.true_input(sensor), stimulus, memory)


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
