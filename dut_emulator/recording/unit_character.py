# pyright: strict
"""What a unit is like: its noise at rest, its errors over temperature, its answer to a step.

Each figure is what the unit's own chains of effects make of a simple stimulus, in SI. Noise is left out
but at rest, the link but in the step, the quantiser in the errors over temperature. A clock that runs fast is
left out throughout: it moves a whole recording, and is no error of a sample.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dut_emulator.effects.dynamics import ClockDrift
from dut_emulator.effects.effect import EffectChain, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.products.product import sample_times_s
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from dut_emulator.twin import Twin
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

SENSORS: tuple[SensorName, ...] = ("gyro", "acc", "mag")
STEP_SI: dict[SensorName, float] = {
    "gyro": math.radians(50.0),
    "acc": STANDARD_GRAVITY_M_S2,
    "mag": 50e-6,
}
"""What a step goes to, and what scale factors are taken at, forth and back."""
STEP_RATE_HZ = 50_000.0
"""Finer than any unit samples: the curve is the sensor's and the link's, not that of its sampling."""
TEMPERATURES_C = (-40.0, 80.0)
TEMPERATURE_RATE_C_S = 1.0 / 60.0
CYCLE_PERIOD_S = 2.0
STEP_AT_S = 0.05
STEP_SPAN_S = 0.5
WARM_S = 1e5
"""Powered for so long before: warm-up is over."""


@dataclass(frozen=True)
class TemperatureCurve:
    """A cycle from room temperature to hot, to cold, and back.

    Attributes:
        temperature_c: (n,).
        error: (n, 3) at rest, level, z up: bias and all that gravity makes.
        scale_factor_error: (n, 3) from one input forth and back, axis by axis.
    """

    temperature_c: FloatArray
    error: FloatArray
    scale_factor_error: FloatArray


def triads(twin: Twin) -> tuple[SensorName, ...]:
    """Those that the unit has."""
    return tuple(sensor for sensor in SENSORS if twin.chain(sensor).effects)


def at_rest(twin: Twin, sensor: SensorName, rate_hz: float, samples: int, seed: int = 1) -> FloatArray:
    """(n, 3) of a unit that lies level, warm and at room temperature."""
    stimulus = _at_rest(np.arange(samples, dtype=np.float64) / rate_hz, rate_hz)
    return _through(_chain(twin, sensor, Stage.QUANTISER, noisy=True), sensor, stimulus, seed)


def over_temperature(twin: Twin, sensor: SensorName) -> TemperatureCurve:
    """The deterministic errors along one cycle of temperature at 1 K a minute."""
    chain = _chain(twin, sensor, Stage.FILTER)
    cycle_c = _cycle_c()
    times_s = np.arange(len(cycle_c), dtype=np.float64) * CYCLE_PERIOD_S
    stimulus = replace(_at_rest(times_s, 1 / CYCLE_PERIOD_S), temperature_c=cycle_c)
    error = _through(chain, sensor, stimulus) - stimulus.true_input(sensor)
    scale = np.empty_like(error)
    for axis in range(3):
        forth, back = (
            _through(chain, sensor, _with_input(stimulus, sensor, axis, sign * STEP_SI[sensor]))
            for sign in (1.0, -1.0)
        )
        scale[:, axis] = (forth - back)[:, axis] / (2 * STEP_SI[sensor]) - 1
    return TemperatureCurve(cycle_c, error, scale)


def step_response(twin: Twin, sensor: SensorName) -> tuple[FloatArray, FloatArray]:
    """Times (n,) from the step and the answer (n, 3), where 1 is the input: delay and bandwidth, no noise."""
    chain = _chain(twin, sensor, Stage.TRANSPORT)
    times_s = sample_times_s(0, STEP_SPAN_S, STEP_RATE_HZ)
    rest = replace(_at_rest(times_s, STEP_RATE_HZ), specific_force_m_s2=np.zeros((len(times_s), 3)))
    answer = np.empty((len(times_s), 3))
    for axis in range(3):
        forth, none = (
            _through(
                chain,
                sensor,
                _with_input(rest, sensor, axis, height * (times_s >= STEP_AT_S).astype(np.float64)),
            )
            for height in (STEP_SI[sensor], 0.0)
        )
        answer[:, axis] = (forth - none)[:, axis] / STEP_SI[sensor]
    return times_s - STEP_AT_S, answer


def _chain(twin: Twin, sensor: SensorName, last: Stage, *, noisy: bool = False) -> EffectChain:
    """The triad's chain up to a stage."""
    return EffectChain(
        effect
        for effect in twin.effects
        if effect.sensor == sensor
        and effect.stage <= last
        and (noisy or not effect.stochastic)
        and not isinstance(effect, ClockDrift)
    )


def _through(chain: EffectChain, sensor: SensorName, stimulus: Stimulus, seed: int = 1) -> FloatArray:
    return chain.apply(stimulus.true_input(sensor), stimulus, chain.begin(np.random.SeedSequence(seed)))


def _cycle_c() -> FloatArray:
    """(n,) room, hot, cold, room."""
    corners = (ROOM_TEMPERATURE_C, TEMPERATURES_C[1], TEMPERATURES_C[0], ROOM_TEMPERATURE_C)
    step_c = TEMPERATURE_RATE_C_S * CYCLE_PERIOD_S
    legs = [np.arange(start, stop, math.copysign(step_c, stop - start)) for start, stop in pairwise(corners)]
    return np.concatenate(legs)


def _at_rest(times_s: FloatArray, rate_hz: float) -> Stimulus:
    """Level, z up, without Earth rate and field; every channel is there for whichever effect asks."""
    count = len(times_s)
    nothing = np.zeros((count, 3))
    return Stimulus(
        time_s=times_s,
        temperature_c=np.full(count, ROOM_TEMPERATURE_C),
        sample_period_s=1 / rate_hz,
        rate_rad_s=nothing,
        specific_force_m_s2=np.tile([0.0, 0.0, STANDARD_GRAVITY_M_S2], (count, 1)),
        field_t=nothing,
        supply_v=np.full(count, 5.0),
        supply_current_a=np.zeros(count),
        angles_rad=nothing,
        earth_rate_rad_s=nothing,
        position_m=nothing,
        dcm_local_from_body=np.broadcast_to(np.eye(3), (count, 3, 3)),
        power_on_s=-WARM_S,
    )


def _with_input(stimulus: Stimulus, sensor: SensorName, axis: int, value: float | FloatArray) -> Stimulus:
    """The same with another true input along one axis, and none along the others."""
    given = np.zeros((len(stimulus.time_s), 3))
    given[:, axis] = value
    if sensor == "gyro":
        return replace(stimulus, rate_rad_s=given)
    if sensor == "acc":
        return replace(stimulus, specific_force_m_s2=given)
    return replace(stimulus, field_t=given)
