# pyright: strict
"""What an effect is, and how effects make a chain.

An effect is a frozen object of parameters that changes samples (n, 3) of one sensor triad, in SI. Effects
do not commute, so each belongs to a stage, and a chain applies them stage by stage:

    mounting     how the triad sits: the input is turned
    transducer   what the sensor makes of the input: scale, bias, noise
    filter       bandwidth
    quantiser    range, then quantum
    transport    what the link does to finished samples

Two exceptions. White noise comes behind the filter: its density is stated for the output. What is late, or
jitters, comes before that noise: the signal is of another moment, the noise of each sample is its own.

What an effect carries from one chunk to the next lies in an `EffectState` that the caller keeps, and each
effect of a chain draws from a generator of its own. Hence a run does not depend on how it was cut into
chunks, and removing one effect leaves the others' noise as it was.

Out of scope: effects that couple two triads' outputs (a gyro's g-sensitivity needs the specific force,
which is in the stimulus).
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, TestloomError

FloatArray = NDArray[np.float64]
SensorName = Literal["gyro", "acc", "mag", "gnss", "temperature"]

SI_UNIT: dict[SensorName, str] = {
    "gyro": "rad/s",
    "acc": "m/s^2",
    "mag": "T",
    "gnss": "m",
    "temperature": "degC",
}
"""What `_si` at the end of a parameter's name stands for, by sensor."""


class Stage(IntEnum):
    """Where in the sensor an effect acts; a chain applies lower stages first."""

    MOUNTING = 0
    TRANSDUCER = 1
    FILTER = 2
    QUANTISER = 3
    TRANSPORT = 4


_TRUE_INPUT: dict[SensorName, str] = {
    "gyro": "rate_rad_s",
    "acc": "specific_force_m_s2",
    "mag": "field_t",
    "gnss": "position_m",
}


@dataclass(frozen=True)
class Stimulus:
    """What acted while the samples were taken; effects read from it, never write.

    What is None was not recorded or plays no part; an effect that needs it refuses. All vectors are in the
    unit's nominal body axes.

    Attributes:
        time_s: (n,) sampling instants.
        temperature_c: (n,) of the sensor.
        sample_period_s: the interval between samples, which must be uniform inside a chunk.
        rate_rad_s: (n, 3) true inertial rate.
        specific_force_m_s2: (n, 3) at the stand's centre.
        field_t: (n, 3) magnetic flux density.
        supply_v: (n,) voltage at the unit's supply pins.
        supply_current_a: (n,) current drawn by the unit.
        angles_rad: (n, 3) gimbal angles of the stand: outer, middle, inner; a crank's angle is 'inner'.
        earth_rate_rad_s: (n, 3) Earth rate in body axes.
        position_m: (n, 3) true position in local axes (east, north, up).
        dcm_local_from_body: (n, 3, 3).
        power_on_s: when the unit was powered, on the clock of `time_s`.
    """

    time_s: FloatArray
    temperature_c: FloatArray
    sample_period_s: float
    rate_rad_s: FloatArray | None = None
    specific_force_m_s2: FloatArray | None = None
    field_t: FloatArray | None = None
    supply_v: FloatArray | None = None
    supply_current_a: FloatArray | None = None
    angles_rad: FloatArray | None = None
    earth_rate_rad_s: FloatArray | None = None
    position_m: FloatArray | None = None
    dcm_local_from_body: FloatArray | None = None
    power_on_s: float = 0.0

    @cached_property
    def steps_s(self) -> FloatArray:
        """(n − 1,) from sample to sample; infinite where time stands still."""
        steps = np.diff(self.time_s)
        steps[steps <= 0] = np.inf
        return steps

    @cached_property
    def _triads(self) -> dict[str, FloatArray]:
        return {}

    @cached_property
    def _waves(self) -> dict[tuple[str, float], tuple[FloatArray, FloatArray]]:
        return {}

    def triad(self, name: str) -> FloatArray:
        """(n, 3) one of the vectors, the samples of an axis side by side; made once for all effects.

        Raises:
            TestloomError: this stimulus has none.
        """
        if name not in self._triads:
            self._triads[name] = np.asfortranarray(self.channel(name))
        return self._triads[name]

    def tone(self, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
        """Sine and cosine of 2πft, (n,) each; made once for all effects."""
        key = "time", frequency_hz
        if key not in self._waves:
            self._waves[key] = _sine_and_cosine(2.0 * np.pi * frequency_hz * self.time_s)
        return self._waves[key]

    def angle_waves(self, axis: int, harmonic: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Sine and cosine of nθ of a gimbal (0 outer, 1 middle, 2 inner), (n,) each; made once for all.

        Whole harmonics are products of the first one's.
        """
        key = str(axis), harmonic
        if key not in self._waves:
            if harmonic > 1.0 and float(harmonic).is_integer():
                self._waves[key] = _multiple_angle(*self.angle_waves(axis), int(harmonic))
            else:
                self._waves[key] = _sine_and_cosine(harmonic * self.triad("angles_rad")[:, axis])
        return self._waves[key]

    def channel(self, name: str) -> FloatArray:
        """One of the attributes.

        Raises:
            TestloomError: this stimulus has none.
        """
        values = getattr(self, name)
        if values is None:
            raise TestloomError(
                f"An effect needs the stimulus '{name}', which is not there.",
                where="stimulus",
                fault=Fault.DATA,
                remedy="record it, or leave the effects out that need it.",
            )
        return values

    def true_input(self, sensor: SensorName) -> FloatArray:
        """(n, 3) what an ideal triad of this kind would put out."""
        if sensor == "temperature":
            return np.repeat(self.temperature_c[:, np.newaxis], 3, axis=1)
        return self.channel(_TRUE_INPUT[sensor])


def _sine_and_cosine(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both by the tangent of the half angle, to the last bit or the one before: a fifth of numpy's time."""
    half = np.tan(0.5 * angle)
    square = half * half
    below = 1.0 + square
    half *= 2.0
    half /= below
    np.subtract(1.0, square, out=square)
    square /= below
    return half, square


def _multiple_angle(sine: FloatArray, cosine: FloatArray, times: int) -> tuple[FloatArray, FloatArray]:
    """sin nθ and cos nθ by doubling and adding angles, bit by bit of n."""
    sine_n, cosine_n = sine, cosine
    for bit in bin(times)[3:]:
        sine_n, cosine_n = 2.0 * sine_n * cosine_n, cosine_n * cosine_n - sine_n * sine_n
        if bit == "1":
            sine_n, cosine_n = sine_n * cosine + cosine_n * sine, cosine_n * cosine - sine_n * sine
    return sine_n, cosine_n


@dataclass
class EffectState:
    """What an effect remembers between chunks. Fresh at power-on.

    Attributes:
        last: (3,) last value of its own process; None before the first sample.
        last_time_s: when that was.
        carried: what else is carried over the cut, by a name of the effect's own.
    """

    last: FloatArray | None = None
    last_time_s: float = 0.0
    carried: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])


class Effect(Protocol):
    """A frozen object of parameters. `sensor` and the class's word make its name in the catalogue."""

    word: ClassVar[str]
    stage: ClassVar[Stage]

    @property
    def sensor(self) -> SensorName:
        """Which triad it belongs to."""
        ...

    @property
    def is_neutral(self) -> bool:
        """True if these parameters change nothing."""
        ...

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """The samples, (n, 3), after this effect. The input stays as it is; `state` is advanced.

        `rng` is drawn from by stochastic effects only, in the order of the samples.
        """
        ...


_FIELD_TERMS = {
    ("gyro", "white_noise"): "angle_random_walk",
    ("acc", "white_noise"): "velocity_random_walk",
}
"""One kind of effect with a name of its own for each sensor (IEEE 952, IEEE 1293)."""


def name_of(effect: Effect) -> str:
    """The effect's name, such as 'gyro.bias_instability', 'acc.velocity_random_walk' or 'stand.wobble'."""
    origin = getattr(effect, "origin", None) or effect.sensor
    return f"{origin}.{_FIELD_TERMS.get((effect.sensor, effect.word), effect.word)}"


@dataclass
class ChainState:
    """The memory of a chain: one state and one generator for each effect."""

    states: dict[str, EffectState] = field(default_factory=dict[str, EffectState])
    generators: dict[str, np.random.Generator] = field(default_factory=dict[str, np.random.Generator])


_BEHIND_THE_FILTER = {"fixed_delay": 0.25, "clock_drift": 0.25, "timestamp_jitter": 0.25, "white_noise": 0.5}


def _place(effect: Effect) -> float:
    """Where in a chain an effect acts: at its stage, but for the exceptions of the module."""
    share = _BEHIND_THE_FILTER.get(effect.word)
    return float(effect.stage) if share is None else Stage.FILTER + share


class EffectChain:
    """The effects of one triad in their order of stages; inside a stage, in the order given.

    White noise acts between filter and quantiser, wherever it is listed: a sensor's density is measured at
    its output, and a sampled output is white up to half its rate whatever pole lies before the sampler. Were
    it moved in time with the signal, between samples, it would be smoothed.

    Raises:
        TestloomError: effects of two sensors, or one effect twice.
    """

    def __init__(self, effects: Iterable[Effect]) -> None:
        self.effects = tuple(sorted(effects, key=_place))
        self.names = tuple(name_of(effect) for effect in self.effects)
        if len({effect.sensor for effect in self.effects}) > 1 or len(set(self.names)) < len(self.names):
            raise TestloomError(
                f"The effects {', '.join(self.names)} do not make one sensor's chain.",
                where="effect chain",
                fault=Fault.DATA,
                remedy="give effects of one sensor, each once.",
            )

    def with_effect(self, effect: Effect) -> "EffectChain":
        """This chain with one effect more, or with this one in place of that of the same name."""
        kept = (other for other in self.effects if name_of(other) != name_of(effect))
        return EffectChain((*kept, effect))

    def begin(self, seed: np.random.SeedSequence) -> ChainState:
        """The memory of a chain at power-on. The same seed gives the same noise."""
        generators = {
            name: np.random.Generator(
                np.random.SFC64(
                    np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *name.encode()))
                )
            )
            for name in self.names
        }
        return ChainState({name: EffectState() for name in self.names}, generators)

    def apply(self, samples: FloatArray, stimulus: Stimulus, memory: ChainState) -> FloatArray:
        """All effects, one after the other: (n, 3) → (n, 3). The input is not changed.

        Effects work axis by axis, so that the samples of an axis lie side by side: twice as fast.
        """
        samples = np.asfortranarray(samples)
        for name, effect in zip(self.names, self.effects, strict=True):
            samples = effect.apply(samples, stimulus, memory.generators[name], memory.states[name])
        return samples
