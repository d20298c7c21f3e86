# pyright: strict
"""The module's satellite receiver from power-on on: what it tracks, where it says it is, its pulse.

Position is the true one through the 'gnss' chain (antenna's arm, multipath, latency, clock step), which runs
at `INNER_RATE_HZ` as a receiver's tracking loops do, plus the receiver's own error: a constant part of the
unit, and the noise of ranges through the satellites' geometry. Velocity is measured by Doppler: the
derivative of the chain's deterministic part, with noise of its own. The pulse has the unit's error, a jitter
and what the signals' time reference is wrong.

Out of scope: carrier phase, ionosphere and troposphere, satellites that rise and set, jamming.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.stochastic import StochasticEffect
from dut_emulator.motion.satellite_profiles import MAX_SATELLITES, SatelliteSignals, SignalSource, open_sky
from dut_emulator.products.gnc_module.gnss_solution import NO_FIX, Geometry, Tracking, geometry_of
from dut_emulator.products.gnc_module.unit_truth import GnssTruth
from dut_emulator.products.product import chain_effects
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin

FloatArray = NDArray[np.float64]

INNER_RATE_HZ, TRACKING_RATE_HZ = 100, 10
VELOCITY_NOISE_M_S = 0.03
"""Of one axis at a position deviation of `REFERENCE_DEVIATION_M`; 0.1 m/s is paper 1's limit (Table 3)."""
REFERENCE_DEVIATION_M = 1.0
PULSE_NOISE_S = 2e-9
_SEARCH_S = (0.5, 3.0)
_CHAIN, _OWN, _START = range(3)
_BACKWARD = np.array([1.5, -2.0, 0.5])
"""Second-order backward difference over two steps: nothing later than now is asked for."""


class Place(Protocol):
    """Where the receiver is: a run, or surroundings."""

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts there."""
        ...


@dataclass(frozen=True)
class Fixes:
    """n epochs. Position and velocity are east, north, up; NaN without a fix, as accuracies and pulse are."""

    time_s: FloatArray
    fix_type: NDArray[np.uint8]
    satellites_used: NDArray[np.uint8]
    position_m: FloatArray
    velocity_m_s: FloatArray
    deviation_m: FloatArray
    position_dop: FloatArray
    pulse_error_s: FloatArray


class GnssReceiver:
    """See the module. `seed`: of this power-on."""

    def __init__(
        self,
        truth: GnssTruth,
        twin: Twin,
        seed: np.random.SeedSequence,
        power_on_s: float,
        place: Place,
        stand_effects: tuple[CatalogueEffect, ...] = (),
    ) -> None:
        self._truth, self._place, self._power_on_s = truth, place, power_on_s
        effects = chain_effects(twin, stand_effects, "gnss")
        steady = tuple(effect for effect in effects if not isinstance(effect, StochasticEffect))
        self._chains = EffectChain(effects), EffectChain(steady)
        self._memories = tuple(chain.begin(child_seed(seed, _CHAIN)) for chain in self._chains)
        self._rng = np.random.Generator(np.random.SFC64(child_seed(seed, _OWN)))
        start = np.random.Generator(np.random.SFC64(child_seed(seed, _START)))
        self._search_s = start.uniform(*_SEARCH_S, MAX_SATELLITES)
        self._frame_offset_s = float(start.uniform(0.0, 30.0))
        self._tracking: Tracking | None = None
        self._inner = max(0, int(np.ceil(power_on_s * INNER_RATE_HZ)))
        self._before: FloatArray | None = None  # the last two inner positions without noise
        self._held_up_m = 0.0
        self._geometries: dict[bytes, Geometry] = {}
        self.last: Fixes | None = None

    @property
    def seen(self) -> int:
        """The last epoch so far; before any, the one before power-on."""
        return self._inner - 1

    def fixes(self, epochs: NDArray[np.int64]) -> Fixes:
        """At these epochs (n,), counted in `INNER_RATE_HZ` from bench time 0, later than all before."""
        times_s = epochs / INNER_RATE_HZ
        signals = self._signals(times_s)
        tracked = self._track(epochs, signals.power_dbm.shape)
        position, velocity = self._antenna(epochs)
        geometries = [
            self._geometry(signals.line_of_sight[row], power[row])
            for row, power in zip(tracked, signals.power_dbm, strict=True)
        ]
        n = len(epochs)
        fix_type = np.fromiter((g.fix_type for g in geometries), np.uint8, n)
        deviation = np.array([g.deviation_m for g in geometries]).reshape(n, 3)
        roots = np.array([g.root for g in geometries]).reshape(n, 3, 4)
        drawn = self._rng.standard_normal((n, 8))
        own = np.einsum("nij,nj->ni", roots, drawn[:, :4]) + np.asarray(self._truth.position_error_m)
        position = self._with_held_height(position + own, fix_type)
        velocity = velocity + VELOCITY_NOISE_M_S / REFERENCE_DEVIATION_M * deviation * drawn[:, 4:7]
        pulse = self._truth.pulse_error_s + PULSE_NOISE_S * drawn[:, 7] + signals.reference_error_s
        position[fix_type == 0], velocity[fix_type == 0] = np.nan, np.nan
        found = Fixes(
            times_s,
            fix_type,
            tracked.sum(axis=1).astype(np.uint8),
            position,
            velocity,
            deviation,
            np.fromiter((g.position_dop for g in geometries), np.float64, n),
            np.where(fix_type > 0, pulse, np.nan),
        )
        self.last = found if n else self.last
        return found

    def _signals(self, times_s: FloatArray) -> SatelliteSignals:
        place = self._place
        return place.signals(times_s) if isinstance(place, SignalSource) else open_sky(times_s)

    def _track(self, epochs: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(n, s) at the epochs; looked after at `TRACKING_RATE_HZ` whatever their rate."""
        if not self._truth.acquires or len(epochs) == 0:
            return np.zeros(shape, dtype=bool)
        step = INNER_RATE_HZ // TRACKING_RATE_HZ
        moments = np.union1d(np.arange(-(-self._inner // step) * step, int(epochs[-1]) + 1, step), epochs)
        times_s = moments / INNER_RATE_HZ
        if self._tracking is None:
            self._tracking = Tracking(self._search_s, self._frame_offset_s, self._power_on_s)
            before_s = np.array([self._power_on_s, max(self._power_on_s, times_s[0] - 1 / INNER_RATE_HZ)])
            self._tracking.tracked(before_s, self._signals(before_s).power_dbm)
        tracked = self._tracking.tracked(times_s, self._signals(times_s).power_dbm)
        return tracked[np.searchsorted(moments, epochs)]

    def _antenna(self, epochs: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Position through the chain and velocity, (n, 3) each, at the epochs."""
        if len(epochs) == 0:
            return np.zeros((0, 3)), np.zeros((0, 3))
        inner = np.arange(self._inner, int(epochs[-1]) + 1)
        self._inner = int(epochs[-1]) + 1
        stimulus = _with_antenna(self._place.stimulus(inner / INNER_RATE_HZ))
        true = stimulus.true_input("gnss")
        full, steady = (
            chain.apply(true, stimulus, memory)
            for chain, memory in zip(self._chains, self._memories, strict=True)
        )
        past = np.repeat(steady[:1], 2, axis=0) if self._before is None else self._before
        line = np.concatenate([past, steady])
        self._before = line[-2:].copy()
        slope = _BACKWARD[0] * line[2:] + _BACKWARD[1] * line[1:-1] + _BACKWARD[2] * line[:-2]
        at = epochs - inner[0]
        return full[at], slope[at] * INNER_RATE_HZ

    def _geometry(self, line_of_sight: FloatArray, power_dbm: FloatArray) -> Geometry:
        """Looked up: few sets of satellites follow each other."""
        key = line_of_sight.tobytes() + power_dbm.tobytes()
        if key not in self._geometries:
            if len(self._geometries) >= 256:
                self._geometries.clear()
            self._geometries[key] = geometry_of(line_of_sight, power_dbm) if len(power_dbm) else NO_FIX
        return self._geometries[key]

    def _with_held_height(self, position: FloatArray, fix_type: NDArray[np.uint8]) -> FloatArray:
        """In a two-dimensional fix the height is that of the last three-dimensional one."""
        index = np.where(fix_type == 3, np.arange(1, len(fix_type) + 1), 0)
        last = np.maximum.accumulate(index)
        heights = np.concatenate([[self._held_up_m], position[:, 2]])
        held = heights[last]
        if len(fix_type):
            self._held_up_m = float(held[-1])
        position[:, 2] = np.where(fix_type == 2, held, position[:, 2])
        return position


def _with_antenna(stimulus: Stimulus) -> Stimulus:
    """At rest at the origin, level, where the place says nothing: the roof's repeated antenna."""
    n = len(stimulus.time_s)
    attitude = stimulus.dcm_local_from_body
    return Stimulus(
        time_s=stimulus.time_s,
        temperature_c=stimulus.temperature_c,
        sample_period_s=1 / INNER_RATE_HZ,
        position_m=np.zeros((n, 3)) if stimulus.position_m is None else stimulus.position_m,
        dcm_local_from_body=np.tile(np.eye(3), (n, 1, 1)) if attitude is None else attitude,
    )
