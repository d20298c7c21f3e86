# pyright: strict
"""What a powered unit makes of what acts on it: temperatures, sensors, correction, attitude.

The same for a unit that is recorded and for one that answers on its link. Heat first: the ambient warms the
network of the housing, the areas' temperatures act on the triads. Then each triad's effects, in two parts: up
to the quantiser they are the sensor's, which the firmware corrects and integrates; those of the transport act
on what is sent, on the attitude too, so that a unit that is late is late in all it says. A delay or a
drift that both triads share moves the instants at which samples are taken and leaves their noise as it is.

Sampling is at the rate of the stream: there is no faster rate inside that would be decimated.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import Bias
from dut_emulator.effects.dynamics import TimeShift
from dut_emulator.effects.effect import (
    ChainState,
    EffectChain,
    EffectState,
    FloatArray,
    Stage,
    Stimulus,
    name_of,
)
from dut_emulator.products.mems_ahrs import cooling
from dut_emulator.products.mems_ahrs.attitude import AttitudeFilter, gates, roll_pitch_yaw_rad
from dut_emulator.products.mems_ahrs.compensation import Flash
from dut_emulator.products.mems_ahrs.thermal_network import ThermalState
from dut_emulator.products.mems_ahrs.unit_effects import (
    ACC_LSB_M_S2,
    ACC_RANGE_M_S2,
    GYRO_LSB_RAD_S,
    GYRO_RANGE_RAD_S,
    TURN_ON_DEVIATION,
)
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError
from protocol.mems_ahrs import CALIBRATED_RANGE_C, SUPPLY_NOMINAL_V, Component, SampleFlag, Sensor

TEMPERATURE_NOISE_K = 0.03
"""Of a triad's mean; each sensor's own thermometer has 0.05 K."""
SENSORS = ("gyro", "acc")
"""Triads that effects can be on; those on 'temperature' belong to the housing."""
Acting = Callable[[FloatArray], Stimulus]
"""What acts on the unit at instants (n,) that do not step back."""
_SAME_STEP = 1e-6
_COMPONENT_NODES = {
    Component.PROCESSOR: "processor",
    Component.POWER_CHIPS: "power_chips",
    Component.GYROS: "gyro_area",
    Component.ACCELEROMETERS: "acc_area",
}


@dataclass(frozen=True)
class AhrsSamples:
    """n samples in SI; rows that the link lost are not numbers. Temperatures (n, 3): mean, gyros, acc."""

    gyro_rad_s: FloatArray
    acc_m_s2: FloatArray
    temperature_c: FloatArray
    attitude_rad: FloatArray
    flags: NDArray[np.uint16]


class Housing:
    """The unit's temperatures, from when it was put where it is. Times go forward.

    `effects`: on 'temperature', the stand's errors of what it says about its own.
    """

    def __init__(
        self,
        parameters: cooling.HousingSet,
        scheme: cooling.Cooling,
        effects: Iterable[CatalogueEffect] = (),
    ) -> None:
        self._network = cooling.housing(scheme, parameters)
        self._chain = EffectChain(effects)
        self._memory = self._chain.begin(np.random.SeedSequence(0))  # none of them draws
        self._state: ThermalState | None = None
        self.last_s = 0.0
        self.heat_w = np.zeros(len(cooling.NODES))
        self.temperatures_c = np.zeros(len(cooling.NODES))

    def settle(self, acting: Stimulus, now_s: float) -> None:
        """All of it has the temperature that is there (one sample); it is `now_s`."""
        ambient_c = float(self._ambient_c(acting, 1.0)[0])
        self._state, self.last_s = ThermalState(self._network, ambient_c), now_s
        self.temperatures_c = self._state.temperatures_c

    def advance(self, acting: Stimulus, period_s: float) -> FloatArray:
        """Instants (n,) spaced by `period_s`, the first one whenever → node temperatures (n, 7)."""
        assert self._state is not None
        times_s = acting.time_s
        if len(times_s) == 0:
            return np.zeros((0, len(cooling.NODES)))
        ambient_c = self._ambient_c(acting, period_s)
        first_s = float(times_s[0]) - self.last_s
        if abs(first_s - period_s) < _SAME_STEP * period_s:
            found = self._state.advance(ambient_c, period_s, self.heat_w)
        else:
            parts = (
                self._state.advance(ambient_c[:1], first_s, self.heat_w),
                self._state.advance(ambient_c[1:], period_s, self.heat_w),
            )
            found = np.concatenate(parts)
        self.last_s, self.temperatures_c = float(times_s[-1]), found[-1]
        return found

    def _ambient_c(self, acting: Stimulus, period_s: float) -> FloatArray:
        """(n,) what the case stands in."""
        stimulus = dataclasses.replace(acting, sample_period_s=period_s)
        return self._chain.apply(acting.true_input("temperature"), stimulus, self._memory).mean(axis=1)

    def components_too_hot(self) -> Component:
        """Components above their rated maximum now."""
        found = Component(0)
        for component, node in _COMPONENT_NODES.items():
            if self.temperatures_c[cooling.NODES.index(node)] > cooling.RATED_MAXIMUM_C[node]:
                found |= component
        return found


class Ahrs:
    """The sensors and the firmware's sums from one power-on to the next."""

    def __init__(
        self,
        effects: Iterable[CatalogueEffect],
        housing: Housing,
        flash: Flash,
        seed: np.random.SeedSequence,
        power_on_s: float,
    ) -> None:
        effects = tuple(effects)
        self._late = _common_shifts(effects)
        names = {name_of(effect) for effect in self._late}
        effects = tuple(effect for effect in effects if name_of(effect) not in names)
        seeds = {
            name: child_seed(seed, number)
            for number, name in enumerate((*SENSORS, "turn_on", "link", "thermometers"))
        }
        turn_on = np.random.Generator(np.random.SFC64(seeds["turn_on"]))
        self._chains: dict[str, EffectChain] = {}
        self._links: dict[str, EffectChain] = {}
        for sensor in SENSORS:
            own = [effect for effect in effects if effect.sensor == sensor]
            inside = [effect for effect in own if effect.stage < Stage.TRANSPORT]
            self._chains[sensor] = EffectChain(_turned_on(inside, sensor, turn_on))
            self._links[sensor] = EffectChain(effect for effect in own if effect.stage >= Stage.TRANSPORT)
        self._memories = {sensor: self._chains[sensor].begin(seeds[sensor]) for sensor in SENSORS}
        self._link_memories: dict[str, ChainState] = {
            sensor: self._links[sensor].begin(child_seed(seeds["link"], number))
            for number, sensor in enumerate(SENSORS)
        }
        self._thermometers = np.random.Generator(np.random.SFC64(seeds["thermometers"]))
        self._shifts = [effect for effect in self._links["gyro"].effects if isinstance(effect, TimeShift)]
        self._shift_states = [EffectState() for _ in self._shifts]
        self._housing, self._power_on_s = housing, power_on_s
        self.flash, self.supply_v = flash, SUPPLY_NOMINAL_V
        self._attitude: AttitudeFilter | None = None

    def begin_stream(self, period_s: float) -> None:
        """The attitude begins anew with the next sample."""
        compensated = not self.flash.is_blank
        self._attitude = AttitudeFilter(period_s, gates(compensated=compensated))
        self._shift_states = [EffectState() for _ in self._shifts]

    def _taken_s(self, times_s: FloatArray) -> FloatArray:
        """(n,) when the samples that are sent at these instants were taken."""
        at = Stimulus(times_s, np.zeros_like(times_s), math.nan, power_on_s=self._power_on_s)
        delays = (
            getattr(shift, name) * pattern
            for shift in self._late
            for name, pattern in shift.delay_patterns(at).items()
        )
        return times_s - sum(delays, np.zeros_like(times_s))

    def sample(
        self, surrounding: Acting, times_s: FloatArray, period_s: float, *, compensated: bool
    ) -> AhrsSamples:
        """Samples sent at `times_s`, spaced by `period_s`; `begin_stream` comes first."""
        assert self._attitude is not None
        count = len(times_s)
        acting = dataclasses.replace(surrounding(self._taken_s(times_s)), time_s=times_s)
        nodes = self._housing.advance(acting, period_s)
        areas_c = nodes[:, [cooling.GYRO_AREA, cooling.ACC_AREA]]
        stimulus = dataclasses.replace(
            acting,
            sample_period_s=period_s,
            supply_v=np.full(count, self.supply_v),
            power_on_s=self._power_on_s,
        )
        at_gyros = dataclasses.replace(stimulus, temperature_c=areas_c[:, 0].copy())
        at_accs = dataclasses.replace(stimulus, temperature_c=areas_c[:, 1].copy())
        gyro = self._chains["gyro"].apply(acting.true_input("gyro"), at_gyros, self._memories["gyro"])
        acc = self._chains["acc"].apply(acting.true_input("acc"), at_accs, self._memories["acc"])
        read_c = areas_c + TEMPERATURE_NOISE_K * self._thermometers.standard_normal((count, 2))
        true_gyro = self.flash.triads[Sensor.GYRO].apply(gyro, read_c[:, 0])
        true_acc = self.flash.triads[Sensor.ACC].apply(acc, read_c[:, 1])
        found = self._attitude.process(true_gyro, true_acc)
        attitude = found.attitude
        for effect, state in zip(self._shifts, self._shift_states, strict=True):
            attitude = effect.apply(attitude, at_gyros, self._thermometers, state)
        flags = (
            SampleFlag.STEADY * found.steady
            | SampleFlag.ALIGNED * found.aligned
            | SampleFlag.GYRO_SATURATED * (np.abs(gyro) > GYRO_RANGE_RAD_S - 0.5 * GYRO_LSB_RAD_S).any(axis=1)
            | SampleFlag.ACC_SATURATED * (np.abs(acc) > ACC_RANGE_M_S2 - 0.5 * ACC_LSB_M_S2).any(axis=1)
            | _thermal_flags(nodes)
            | (SampleFlag.COMPENSATED if compensated else 0)
        )
        sent_gyro, sent_acc = (true_gyro, true_acc) if compensated else (gyro, acc)
        return AhrsSamples(
            gyro_rad_s=self._links["gyro"].apply(sent_gyro, at_gyros, self._link_memories["gyro"]),
            acc_m_s2=self._links["acc"].apply(sent_acc, at_accs, self._link_memories["acc"]),
            temperature_c=np.column_stack([read_c.mean(axis=1), read_c]),
            attitude_rad=roll_pitch_yaw_rad(attitude / np.linalg.norm(attitude, axis=1, keepdims=True)),
            flags=flags.astype(np.uint16),
        )


def _common_shifts(effects: Iterable[CatalogueEffect]) -> tuple[TimeShift, ...]:
    """The gyros' shifts of time that the accelerometers have too; any others act on what is sent."""
    shifts = [effect for effect in effects if isinstance(effect, TimeShift)]
    return tuple(
        shift
        for shift in shifts
        if shift.sensor == "gyro" and dataclasses.replace(shift, sensor="acc") in shifts
    )


def _thermal_flags(nodes_c: FloatArray) -> NDArray[np.int64]:
    sensors = nodes_c[:, [cooling.GYRO_AREA, cooling.ACC_AREA]]
    low, high = CALIBRATED_RANGE_C
    beyond = ((sensors < low) | (sensors > high)).any(axis=1)
    rated = np.array([cooling.RATED_MAXIMUM_C.get(node, np.inf) for node in cooling.NODES])
    flags: NDArray[np.int64] = np.where(beyond, int(SampleFlag.BEYOND_CALIBRATED), 0)
    flags |= np.where((nodes_c > rated).any(axis=1), int(SampleFlag.OVER_TEMPERATURE), 0)
    return flags


def _turned_on(
    effects: list[CatalogueEffect], sensor: str, rng: np.random.Generator
) -> list[CatalogueEffect]:
    """With the bias of this power-on."""
    found: list[CatalogueEffect] = []
    for effect in effects:
        if isinstance(effect, Bias) and sensor in TURN_ON_DEVIATION:
            bias = np.asarray(effect.bias_si) + TURN_ON_DEVIATION[sensor] * rng.standard_normal(3)
            x, y, z = (float(value) for value in bias)
            effect = dataclasses.replace(effect, bias_si=(x, y, z))
        found.append(effect)
    return found


def check_twin(twin: Twin) -> None:
    """Refuse what a unit of this kind cannot have.

    Raises:
        TestloomError: another product's twin, or an effect on a sensor that it lacks.
    """
    if twin.product not in ("", "mems_ahrs"):
        raise _refused(f"The twin is one of a {twin.product}.", "give a twin of a mems_ahrs.")
    for effect in twin.effects:
        if effect.sensor not in (*SENSORS, "temperature"):
            raise _refused(
                f"A mems_ahrs has no {effect.sensor}, and cannot have '{name_of(effect)}'.",
                "leave out effects on anything but gyro, acc and temperature.",
            )


def _refused(what: str, remedy: str) -> TestloomError:
    return TestloomError(what, where="twin of a mems_ahrs", fault=Fault.DATA, remedy=remedy)
