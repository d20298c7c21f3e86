# pyright: strict
"""The gyro from the input's motion to the frame's numbers.

A frame whose last byte has come at t shows the motion up to t − L, L the pure lag (paper 3, section 1):
the input is evaluated there, not moved by whole samples. What makes up the lag (TL, paper 3 says only that
it depends on temperature and frame rate):

    L(f, T) = L_ref + 0.1 (1 / f − 1 / 2 kHz) + 5e-4 /°C (T − 25 °C) L_processing

Twin's `link.fixed_delay` is L_ref: at 2 kHz and 25 °C. The frames' decimation window is a fifth of their
period, half of it is delay. L_processing is what is left of L_ref beside that and the 130 µs on the line.

The loop's one pole (`gyro.bandwidth`, time constant τ) acts on the input before it is sampled, with no
grid either; the noise density is the output's, behind it:

    y(t) = ∫ u(t − x τ) e^(−x) dx,  x = 0 … ∞

Smooth motion takes Radau's rule with two nodes, exact for parabolas: y = (u(t) + u(t − 2τ)) / 2. Where the
input jumps between the nodes (an impact), the integral is a mean over 1024 ages of equal weight instead:
1/1024 of the jump, 0.05 µs of its instant. Jumps below 0.5 °/s may go unseen and come out in two halves.

Out of scope: what the decimation window does beside its delay (it shows where the motion changes within a
window: at low frame rates), and a delay of the temperature's reading.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.dynamics import Bandwidth, FixedDelay
from dut_emulator.effects.effect import EffectChain, FloatArray, Stimulus
from dut_emulator.products.fog.population import COUNT_RAD_S, PRODUCT_NAME
from dut_emulator.products.product import chain_effects
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError
from protocol.fog import (
    COUNTS_PER_DEG_S,
    DEFAULT_FRAME_RATE_HZ,
    FRAME_RATES_HZ,
    FRAME_TRANSMISSION_S,
    RANGE_DEG_S,
    TEMPERATURE_LSB_C,
    ZERO_RATE_COUNTS,
    FrameStatus,
)

INPUT_AXIS = 2
"""Body z."""
WINDOW_SHARE = 0.1
"""Delay of the decimation, in frame periods."""
PROCESSING_PER_C = 5e-4
REFERENCE_C = 25.0
SELF_HEATING_C = 3.0
SELF_HEATING_TIME_S = 600.0
"""TL: light source and electronics warm the coil."""

SUPPLY_V, SUPPLY_A = 5.0, 0.6
"""TL: light source, cooler, electronics."""

FAR_AGE = 8.0
"""In τ: older input weighs 3e-4."""
MIDDLE_AGE = 2.0
CURVED_RAD_S = 2e-3
"""The input's middle value may leave the chord by so much before the fine rule is taken."""
FINE_AGES = 1024

_GYRO, _TEMPERATURE = range(2)

Acting = Callable[[FloatArray], Stimulus]


@dataclass(frozen=True)
class FogSamples:
    """What n frames say: counts, 0.01 °C, status bits; `lost`: frames that do not arrive."""

    rate: NDArray[np.int32]
    temperature: NDArray[np.int16]
    status: NDArray[np.uint8]
    lost: NDArray[np.bool_]


class FogSensor:
    """One gyro from a power-on on. Calls go forward in time. `supply_v`: at its pins, to be set.

    Raises:
        TestloomError: the twin has effects of a triad that a gyro has not, or the frame rate cannot be.
    """

    def __init__(
        self,
        twin: Twin,
        stand_effects: tuple[CatalogueEffect, ...],
        seed: np.random.SeedSequence,
        power_on_s: float,
    ) -> None:
        check_effects(twin)
        effects = chain_effects(twin, stand_effects, "gyro")
        self.supply_v = SUPPLY_V
        self._power_on_s = power_on_s
        self._lag_ref_s = sum(effect.delay_s for effect in effects if isinstance(effect, FixedDelay))
        self._pole_s = sum(effect.time_constant_s for effect in effects if isinstance(effect, Bandwidth))
        chained = (effect for effect in effects if not isinstance(effect, FixedDelay | Bandwidth))
        self._gyro = EffectChain(chained)
        self._thermal = EffectChain(chain_effects(twin, stand_effects, "temperature"))
        self._gyro_memory = self._gyro.begin(child_seed(seed, _GYRO))
        self._thermal_memory = self._thermal.begin(child_seed(seed, _TEMPERATURE))

    def lag_s(self, frame_rate_hz: float, temperature_c: FloatArray) -> FloatArray:
        """(n,) the pure lag; none at all for a twin without one."""
        if self._lag_ref_s == 0:
            return np.zeros_like(temperature_c)
        window_s = WINDOW_SHARE / DEFAULT_FRAME_RATE_HZ
        processing_s = max(self._lag_ref_s - FRAME_TRANSMISSION_S - window_s, 0.0)
        warm = PROCESSING_PER_C * (temperature_c - REFERENCE_C) * processing_s
        return np.maximum(self._lag_ref_s + WINDOW_SHARE / frame_rate_hz - window_s + warm, 0.0)

    def sample(self, received_s: FloatArray, frame_rate_hz: float, acting: Acting) -> FogSamples:
        """Frames whose last bytes come at these instants (n,).

        `acting` says what acts on the unit at any times up to then, also shortly before it was powered.
        """
        temperature_c = self._temperature_c(acting(received_s), received_s, frame_rate_hz)
        shown_s = received_s - self.lag_s(frame_rate_hz, temperature_c)
        stimulus = acting(shown_s)
        stimulus = dataclasses.replace(
            stimulus,
            time_s=received_s,
            rate_rad_s=self._behind_pole(shown_s, stimulus.channel("rate_rad_s"), acting),
            temperature_c=temperature_c,
            supply_v=np.full(len(received_s), self.supply_v),
            supply_current_a=np.full(len(received_s), SUPPLY_A),
            sample_period_s=1.0 / frame_rate_hz,
            power_on_s=self._power_on_s,
        )
        outputs = self._gyro.apply(stimulus.channel("rate_rad_s"), stimulus, self._gyro_memory)
        rate_rad_s = outputs[:, INPUT_AXIS]
        lost = np.isnan(rate_rad_s)
        counts = np.rint(np.where(lost, 0.0, rate_rad_s) / COUNT_RAD_S).astype(np.int32)
        status = np.where(
            np.abs(counts) >= RANGE_DEG_S * COUNTS_PER_DEG_S, FrameStatus.SATURATED.value, 0
        ).astype(np.uint8)
        reading = np.rint(temperature_c / TEMPERATURE_LSB_C).astype(np.int16)
        return FogSamples(counts + np.int32(ZERO_RATE_COUNTS), reading, status, lost)

    def _temperature_c(self, around: Stimulus, times_s: FloatArray, frame_rate_hz: float) -> FloatArray:
        """(n,) of the coil."""
        stimulus = dataclasses.replace(around, sample_period_s=1.0 / frame_rate_hz)
        mount_c = self._thermal.apply(around.true_input("temperature"), stimulus, self._thermal_memory)[
            :, INPUT_AXIS
        ]
        since = np.maximum(times_s - self._power_on_s, 0.0)
        return mount_c - SELF_HEATING_C * np.expm1(-since / SELF_HEATING_TIME_S)

    def _behind_pole(self, shown_s: FloatArray, rate_rad_s: FloatArray, acting: Acting) -> FloatArray:
        """(n, 3) the input as the loop follows it."""
        if self._pole_s == 0 or len(shown_s) == 0:
            return rate_rad_s
        middle = acting(shown_s - MIDDLE_AGE * self._pole_s).channel("rate_rad_s")
        far = acting(shown_s - FAR_AGE * self._pole_s).channel("rate_rad_s")
        share = MIDDLE_AGE / FAR_AGE
        followed = (rate_rad_s + middle) / 2
        leaves_chord = np.abs(middle - (1 - share) * rate_rad_s - share * far)
        curved = np.flatnonzero(leaves_chord.max(axis=1) > CURVED_RAD_S)
        if len(curved):
            followed[curved] = self._fine_mean(shown_s[curved], acting)
        return followed

    def _fine_mean(self, shown_s: FloatArray, acting: Acting) -> FloatArray:
        """(m, 3) mean over ages that are equally probable under e^(−x)."""
        ages_s = -self._pole_s * np.log1p(-(np.arange(FINE_AGES) + 0.5) / FINE_AGES)
        means = np.empty((len(shown_s), 3))
        for row, shown in enumerate(shown_s.tolist()):
            means[row] = acting(shown - ages_s[::-1]).channel("rate_rad_s").mean(axis=0)
        return means


def check_frame_rate(rate_hz: float) -> None:
    """Refuse a frame rate that the gyro has not.

    Raises:
        TestloomError: it is outside the range.
    """
    low, high = FRAME_RATES_HZ
    if not low <= rate_hz <= high:
        raise TestloomError(
            f"The gyro cannot send {rate_hz:g} frames a second.",
            where=f"product {PRODUCT_NAME}",
            fault=Fault.OPERATOR,
            remedy=f"use {low} to {high} Hz.",
        )


def check_effects(twin: Twin) -> None:
    """Refuse a twin of another kind of unit.

    Raises:
        TestloomError: an effect of a sensor that a gyro has not.
    """
    for effect in twin.effects:
        if effect.sensor not in ("gyro", "temperature"):
            raise TestloomError(
                f"The twin has an effect of a sensor '{effect.sensor}', which a gyro has not.",
                where=f"product {PRODUCT_NAME}, twin",
                fault=Fault.DATA,
                remedy="leave it out: a FOG has the sensors gyro and temperature.",
            )
