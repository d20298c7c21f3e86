# pyright: strict
"""Candidate causes: effects of the catalogue in the shapes that a search tries, and their regressors.

An effect has free parameters, which are linear or made so, and held ones, which give it its shape: a time
constant, the width of a play, an axis of the stand. A trial is an effect with its held parameters chosen; an
effect's trials share its name. What an effect that is not linear does is linearised at the trial's value and
brought to the data's by repeating (`refined_trials`).
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from dut_emulator.effects.catalogue import CATALOGUE
from dut_emulator.effects.catalogue_effect import CatalogueEffect, LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stimulus
from dut_emulator.effects.parameters import scalars, with_values
from dut_emulator.effects.stand import AXIS_NAMES
from gap_diagnosis.observation import Observation
from protocol.errors import TestloomError

CONSTANT = frozenset({"misalignment", "scale_factor_error", "bias", "hard_iron", "soft_iron"})
"""Constants that every mount is recalibrated for: they are nuisances, not gaps."""
ABSORBED = frozenset({"remount_misalignment", "rate_scale_factor", "cross_axis_sensitivity"})
"""Constants too, of one unit at one mount; several units or mounts tell them (`cohort`)."""
SEEN_OTHERWISE = frozenset(
    {
        *("frame_loss", "duplicate_frames", "counter_wrap", "timestamp_jitter", "quantization"),
        *("aliasing", "mains_interference"),
    }
)
"""Found by the timing stage, by the samples' steps or by spectral lines, not by regressors."""
NOT_OF_A_TRIAD = frozenset({"latency", "clock_step", "antenna_lever_arm", "multipath", "crank_geometry"})

WITH_TEMPERATURE = frozenset(
    {"bias_temperature", "scale_factor_temperature", "misalignment_temperature", "temperature_rate"}
)

TIME_CONSTANTS, PLAY_WIDTHS, RATE_WIDTHS, BAND_WIDTHS = 9, 7, 9, 8
SHORTEST_WARM_UP_S = 4.0
LAGS_S = (0.002, 0.008, 0.03)
DELAYS_S = (0.001, 0.004, 0.015, 0.06)
CHAMBER_LAGS_S = (10.0, 30.0, 90.0, 270.0)
DRIFT = 2e-5
WOBBLE_HARMONICS = (1.0, 2.0)
FIELD_HARMONICS = (1.0, 2.0, 3.0)
RIPPLE_HARMONICS = tuple(float(n) for n in (*range(1, 25), 28, 30, 32, 36, 40, 48, 60, 64, 72, 90, 120, 180))
SATURATION_SHARES = (0.7, 0.8, 0.87, 0.91, 0.94, 0.96, 0.975, 0.985, 0.992, 0.997)
LEAST_TURN_RAD = 0.3
REMEMBERED_ROWS = 40_000
"""Of a longer record the waves of all harmonics together would fill some hundred megabytes."""


@dataclass(frozen=True)
class Trial:
    """One shape of one effect.

    Attributes:
        name: in the catalogue.
        effects: one for each triad that it acts on here, held parameters chosen.
        tied: one set of parameters for all triads: a stand turns all of a unit, a link delays whole frames.
    """

    name: str
    effects: tuple[CatalogueEffect, ...]
    tied: bool = False


@dataclass(frozen=True)
class Excitation:
    """How far the recordings move what effects depend on: decides which shapes are worth trying."""

    longest_on_s: float
    longest_s: float
    row_s: float
    temperature_span_c: float
    rate_range_si: float
    rates_si: FloatArray
    force_range_si: float
    turned: tuple[bool, bool, bool]
    largest_input_si: Mapping[SensorName, float]


def excitation_of(observations: Sequence[Observation]) -> Excitation:
    """What all recordings together excite."""
    stimuli = [one.stimulus for one in observations]

    def joined(name: str) -> FloatArray:
        parts = [np.abs(getattr(s, name)).ravel() for s in stimuli if getattr(s, name) is not None]
        return np.concatenate(parts) if parts else np.zeros(1)

    rates, forces = joined("rate_rad_s"), joined("specific_force_m_s2")
    spans = [
        np.ptp(s.angles_rad, axis=0) if s.angles_rad is not None and len(s.angles_rad) else np.zeros(3)
        for s in stimuli
    ]
    told = [one.stimulus.temperature_c for one in observations if one.has_temperature]
    temperature = np.concatenate(told) if told else np.zeros(1)
    largest: dict[SensorName, float] = {}
    for one in observations:
        for sensor in one.outputs:
            predicted = np.abs(one.outputs[sensor].predicted_si)
            if np.isfinite(predicted).any():
                largest[sensor] = max(largest.get(sensor, 0.0), float(np.nanmax(predicted)))
    return Excitation(
        longest_on_s=max(float(s.time_s[-1] - s.power_on_s) for s in stimuli),
        longest_s=max(float(s.time_s[-1] - s.time_s[0]) for s in stimuli),
        row_s=min(s.sample_period_s for s in stimuli),
        temperature_span_c=float(np.ptp(temperature)),
        rate_range_si=float(rates.max(initial=0.0)),
        rates_si=rates[rates > 1e-6],
        force_range_si=float(forces.max(initial=0.0)),
        turned=cast(
            "tuple[bool, bool, bool]", tuple(bool(x) for x in np.max(spans, axis=0) > LEAST_TURN_RAD)
        ),
        largest_input_si=largest,
    )


def trials_for(observations: Sequence[Observation], without: frozenset[str] = frozenset()) -> list[Trial]:
    """All trials of the catalogue that these recordings can say something about."""
    excitation = excitation_of(observations)
    present = {sensor for one in observations for sensor in one.outputs}
    trials: list[Trial] = []
    for name, (kind, sensors) in CATALOGUE.items():
        left_out = CONSTANT | ABSORBED | SEEN_OTHERWISE | NOT_OF_A_TRIAD
        mine = cast("list[SensorName]", [sensor for sensor in sensors if sensor in present])
        if name in without or kind.stochastic or kind.word in left_out or not mine:
            continue
        for held in _shapes(name, kind, excitation):
            effects = tuple(_begun(kind(sensor), held) for sensor in mine)
            common = kind.origin in {"stand", "link"} and len(effects) > 1
            if common:
                trials.append(Trial(name, effects, tied=True))
            if not common or kind.origin == "link":
                trials.append(Trial(name, effects))
    return trials


def _begun(effect: CatalogueEffect, held: Mapping[str, Any]) -> CatalogueEffect:
    return dataclasses.replace(effect, **{**type(effect).start, **held})


Held = dict[str, Any]


def _shapes(name: str, kind: type[CatalogueEffect], seen: Excitation) -> Iterator[Held]:
    """Held parameters to try, coarse; the best are refined."""
    if kind.word in _SHAPES:
        yield from _SHAPES[kind.word](name, seen)
    elif issubclass(kind, LinearEffect):
        yield {}


def _over_temperature(_name: str, seen: Excitation) -> Iterator[Held]:
    if seen.temperature_span_c > 1.0:
        yield {}


def _thermal_hysteresis(_name: str, seen: Excitation) -> Iterator[Held]:
    if seen.temperature_span_c > 2.0:
        for width in _between(0.7, 0.6 * seen.temperature_span_c, PLAY_WIDTHS):
            yield {"half_width_c": width}


def _warm_up(_name: str, seen: Excitation) -> Iterator[Held]:
    for tau in _between(max(5.0, 10 * seen.row_s), 1.2 * seen.longest_on_s, TIME_CONSTANTS):
        yield {"time_constant_s": tau}


def _dead_band(_name: str, seen: Excitation) -> Iterator[Held]:
    if len(seen.rates_si):
        low, high = np.quantile(seen.rates_si, (0.01, 0.99))
        for width in _between(max(float(low), 1e-4), min(float(high), 0.5), BAND_WIDTHS):
            yield {"half_width_si": width}


def _rate_hysteresis(_name: str, seen: Excitation) -> Iterator[Held]:
    if seen.rate_range_si > 1e-3:
        for width in _between(2e-3, 0.5 * seen.rate_range_si, RATE_WIDTHS):
            yield {"half_width_si": width}


def _shock(_name: str, seen: Excitation) -> Iterator[Held]:
    if seen.force_range_si > 25.0:
        for share in (0.35, 0.5, 0.7, 0.9):
            yield {"threshold_si": share * seen.force_range_si}


def _bandwidth(_name: str, seen: Excitation) -> Iterator[Held]:
    yield from ({"time_constant_s": tau} for tau in LAGS_S if tau > 0.1 * seen.row_s)


def _fixed_delay(_name: str, seen: Excitation) -> Iterator[Held]:
    yield from ({"delay_s": delay} for delay in DELAYS_S if delay > 0.05 * seen.row_s)


def _clock_drift(_name: str, _seen: Excitation) -> Iterator[Held]:
    yield {"relative_rate": DRIFT}


def _saturation(name: str, seen: Excitation) -> Iterator[Held]:
    largest = seen.largest_input_si.get(cast("SensorName", name.split(".", maxsplit=1)[0]), 0.0)
    if largest > 0.0:
        yield from ({"range_si": share * largest} for share in SATURATION_SHARES)


def _chamber_lag(_name: str, _seen: Excitation) -> Iterator[Held]:
    yield from ({"time_constant_s": tau} for tau in CHAMBER_LAGS_S)


def _about_axes(*harmonics: float) -> Callable[[str, Excitation], Iterator[Held]]:
    def shapes(_name: str, seen: Excitation) -> Iterator[Held]:
        for axis in (axis for axis, moved in zip(AXIS_NAMES, seen.turned, strict=True) if moved):
            yield from ({"axis": axis, "harmonic": n} for n in harmonics)
            if not harmonics:
                yield {"axis": axis}

    return shapes


_SHAPES: dict[str, Callable[[str, Excitation], Iterator[Held]]] = {
    **dict.fromkeys(
        ("bias_temperature", "scale_factor_temperature", "misalignment_temperature", "temperature_rate"),
        _over_temperature,
    ),
    "thermal_hysteresis": _thermal_hysteresis,
    "warm_up": _warm_up,
    "dead_band": _dead_band,
    "rate_hysteresis": _rate_hysteresis,
    "shock_bias_shift": _shock,
    "bandwidth": _bandwidth,
    "fixed_delay": _fixed_delay,
    "clock_drift": _clock_drift,
    "saturation": _saturation,
    "chamber_lag": _chamber_lag,
    "wobble": _about_axes(*WOBBLE_HARMONICS),
    "motor_field": _about_axes(*FIELD_HARMONICS),
    "rate_ripple": _about_axes(*RIPPLE_HARMONICS),
    "encoder_eccentricity": _about_axes(),
}


def _between(low: float, high: float, count: int) -> list[float]:
    return [] if high <= low else [float(x) for x in np.geomspace(low, high, count)]


def regressors(effect: CatalogueEffect, stimulus: Stimulus) -> dict[str, FloatArray] | None:
    """Free scalar → (n, 3) what one unit of it adds to an ideal output; None: the stimulus lacks its input.

    An effect that is not linear is divided by its value: one unit of its scalar, at that value.
    """
    if len(stimulus.time_s) > REMEMBERED_ROWS:
        stimulus = dataclasses.replace(stimulus)  # what effects have it remember goes with the copy
    try:
        if isinstance(effect, LinearEffect):
            return effect.basis(stimulus)
        (scalar,) = scalars(effect, free_only=True)
        samples = stimulus.true_input(effect.sensor)
        idle = np.random.Generator(np.random.SFC64(0))  # a deterministic effect draws nothing from it
        change = effect.apply(samples, stimulus, idle, EffectState()) - samples
        return {scalar.name: change / scalar.value}
    except TestloomError:
        return None


def has_shape(trial: Trial) -> bool:
    """Whether the trial's effects have a number that a search must find: a held one, or a curve's place."""
    return any(type(e).scanned or is_curve(e) for e in trial.effects)


def is_curve(effect: CatalogueEffect) -> bool:
    """Whether the effect's free scalar bends what it does, so that a fit is repeated at its value."""
    return not isinstance(effect, LinearEffect) and effect.word != "saturation"


def is_neighbour(trial: Trial, other: Trial) -> bool:
    """Whether two trials are of one effect and differ in a number of their shape alone."""
    return (trial.name, trial.tied) == (other.name, other.tied) and all(
        getattr(one, "axis", None) == getattr(two, "axis", None)
        and getattr(one, "harmonic", None) == getattr(two, "harmonic", None)
        for one, two in zip(trial.effects, other.effects, strict=True)
    )


def refined_trials(trial: Trial, factor: float) -> list[Trial]:
    """The trial with its scanned held parameters a little to both sides, by a factor above 1."""
    found: list[Trial] = []
    for step in (1.0 / factor, factor):
        moved = tuple(_scaled(effect, step) for effect in trial.effects)
        if all(one is not None for one in moved):
            found.append(Trial(trial.name, cast("tuple[CatalogueEffect, ...]", moved), trial.tied))
    return found


def _scaled(effect: CatalogueEffect, step: float) -> CatalogueEffect | None:
    names = [name for name in type(effect).scanned if name != "threshold_si"]
    if not names:
        return None
    by_name = {scalar.name: scalar for scalar in scalars(effect)}
    values = {name: by_name[name].value * step for name in names}
    if effect.word == "warm_up" and values["time_constant_s"] < SHORTEST_WARM_UP_S:
        return None  # over before the first samples: nothing would hold its amplitude
    if any(not by_name[name].low <= value <= by_name[name].high for name, value in values.items()):
        return None
    return with_values(effect, values)
