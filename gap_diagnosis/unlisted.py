# pyright: strict
# ruff: noqa: ARG002  an effect's one signature
"""What the catalogue does not list: a channel that follows some variable of the test in any curve.

A rival to every set of effects, so that the catalogue's nearest effect, or slow noise, is not named with a
probability near 1 where the true cause is none of them. The forms: products of two variables, a broken line
over one, harmonics of a table angle. They are weighed like effects: each has more amplitudes than most
effects, and there are many of them, so an effect that explains the data as well is the more probable.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, Triple, parameter
from dut_emulator.effects.stand import AXIS_NAMES
from gap_diagnosis.candidates import LEAST_TURN_RAD, Trial
from gap_diagnosis.observation import AXES, Observation
from gap_diagnosis.unknown_drift import wandering
from protocol.errors import Fault, TestloomError

UNLISTED = "unlisted"
"""Takes the place of an effect's name; no effect has it."""
KNOTS, KNOTS_OF_TIME = 5, 20
HARMONICS = 3
WITHIN_S = 10.0
"""A rate of temperature is a difference over so long."""
TIME = "time_since_power_on"
LEAST_SPANS: Mapping[str, float] = {
    **{"temperature": 2.0, "temperature_rate": 0.005, TIME: 30.0, "supply": 0.01},
    **{f"rate_{axis}": 1e-3 for axis in AXES},
    **{f"acceleration_{axis}": 0.2 for axis in AXES},
}
"""Variable → span, SI and degC, below which nothing follows it."""
LARGEST = 1e9
_INPUTS: dict[SensorName, str] = {"gyro": "rate", "acc": "acceleration", "mag": "field"}


def _vector(stimulus: Stimulus, name: str) -> FloatArray | None:
    """(n, 3) the rates, the specific force or the field."""
    return {
        "rate": stimulus.rate_rad_s,
        "acceleration": stimulus.specific_force_m_s2,
        "field": stimulus.field_t,
    }[name]


def _temperature_rate(stimulus: Stimulus) -> FloatArray:
    t, half = stimulus.time_s, 0.5 * WITHIN_S
    order = np.argsort(t, kind="stable")
    ahead, behind = np.minimum(t + half, t.max()), np.maximum(t - half, t.min())
    known = t[order], stimulus.temperature_c[order]
    change = np.interp(ahead, *known) - np.interp(behind, *known)
    return change / np.maximum(ahead - behind, 1e-3)


def variable(stimulus: Stimulus, name: str) -> FloatArray | None:
    """(n,) a variable of the test, SI and degC; None: the stimulus does not tell it."""
    if name == "temperature":
        return stimulus.temperature_c
    if name == "temperature_rate":
        return _temperature_rate(stimulus)
    if name == TIME:
        return stimulus.time_s - stimulus.power_on_s
    if name == "supply":
        return stimulus.supply_v
    word, _, axis = name.rpartition("_")
    if word == "table_angle":
        angles = stimulus.angles_rad
        return None if angles is None else angles[:, AXIS_NAMES.index(axis)]
    of_axis = _vector(stimulus, word)
    return None if of_axis is None else of_axis[:, AXES.index(axis)]


@dataclass(frozen=True)
class Unlisted(LinearEffect):
    """y = u + Σ_k a_k X_k, patterns X of one variable or of two.

    `variable`: see `variable`; `low`, `high`: between which it moves over all recordings; `times`: a vector
    ('rate', 'acceleration', 'field') by whose components it is multiplied, or none.
    """

    amplitude: tuple[Triple, ...] = parameter(
        (ZERO,), "{si}", (-LARGEST, LARGEST), "of each pattern on each axis", powers=True
    )
    variable: str = ""
    low: float = 0.0
    high: float = 1.0
    times: str = ""
    word: ClassVar[str] = UNLISTED
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`: (k, n, 1)."""
        values = variable(stimulus, self.variable)
        factor = _vector(stimulus, self.times) if self.times else None
        if values is None or (self.times and factor is None):
            raise TestloomError(
                f"The stimulus does not tell '{self.variable}' and what it is multiplied by.",
                where="gap diagnosis",
                fault=Fault.DATA,
                remedy="leave this form out for this recording.",
            )
        return {"amplitude": _patterns(self, values, factor)[:, :, np.newaxis]}

    @property
    def description(self) -> str:
        """What it follows."""
        return f"{self.variable} times {self.times}" if self.times else self.variable


def _patterns(form: Unlisted, values: FloatArray, factor: FloatArray | None) -> FloatArray:
    """(k, n)."""
    if factor is not None:
        centred = (values - 0.5 * (form.low + form.high)) / (form.high - form.low)
        return factor.T * centred
    if form.variable.startswith("table_angle"):
        orders = np.arange(1, HARMONICS + 1)[:, np.newaxis]
        return np.concatenate([np.sin(orders * values), np.cos(orders * values)])
    place = (values - form.low) / (form.high - form.low)
    if form.variable == TIME:
        place = np.sqrt(np.maximum(place, 0.0))  # what follows the time since power-on is quickest at first
    count = _knots(form.variable)
    place = place * (count - 1)
    knots = np.arange(1, count)[:, np.newaxis]  # all but the first, which the bias stands for
    return np.maximum(0.0, 1.0 - np.abs(place - knots))


def _knots(name: str) -> int:
    return KNOTS_OF_TIME if name == TIME else KNOTS


def unlisted_trials(observations: Sequence[Observation]) -> list[Trial]:
    """All forms that these recordings move, for each triad.

    Where nothing is believed of slow noise, nothing is said to follow the time (see `unknown_drift`).
    """
    sensors: list[SensorName] = [s for s in _INPUTS if any(s in one.outputs for one in observations)]
    trials: list[Trial] = []
    for name, least in _variables():
        span = _span(observations, name)
        if span is None or span[1] - span[0] <= least:
            continue
        for sensor in sensors:
            if name == TIME and any(sensor in wandering(one) for one in observations):
                continue
            for times in ("", *_factors(name, sensor)):
                trials.append(Trial(UNLISTED, (_form(sensor, name, span, times),)))
    return trials


def _form(sensor: SensorName, name: str, span: tuple[float, float], times: str) -> Unlisted:
    count = 3 if times else 2 * HARMONICS if name.startswith("table_angle") else _knots(name) - 1
    return Unlisted(sensor, (ZERO,) * count, name, span[0], span[1], times)


def _variables() -> Iterator[tuple[str, float]]:
    yield from LEAST_SPANS.items()
    yield from ((f"table_angle_{axis}", LEAST_TURN_RAD) for axis in AXIS_NAMES)


def _factors(name: str, sensor: SensorName) -> tuple[str, ...]:
    """What a variable is multiplied by: a scale factor or a sensitivity that follows it."""
    if name == "temperature":
        return ("field",) if sensor == "mag" else ("rate", "acceleration")
    if name in ("temperature_rate", TIME):
        return (_INPUTS[sensor],)
    if name.startswith("rate"):
        return ("rate", "acceleration") if sensor == "gyro" else ()
    if name.startswith("acceleration"):
        return ("acceleration",) if sensor == "acc" else ()
    return ()


def _span(observations: Sequence[Observation], name: str) -> tuple[float, float] | None:
    low, high = math.inf, -math.inf
    for one in observations:
        if name.startswith("temperature") and not one.has_temperature:
            continue
        values = variable(one.stimulus, name)
        values = values[np.isfinite(values)] if values is not None else values
        if values is not None and len(values):
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    return (low, high) if high > low else None
