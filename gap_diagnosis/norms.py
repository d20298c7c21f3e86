# pyright: strict
"""Triads that no stand predicts, seen by their norm: a field that stays as it is, gravity in rests.

Turned all ways, |u| stays the same, and what the believed constants make of y should have that length too.
About the constants that fit best (`norm_fit`) the gap is, to first order,

    r = ρ + Σ_k (∂|u|/∂a_k) a_k = m · Σ_k X_k(u) a_k + n        m = M⁻ᵀ u/|u|, ρ what the fit leaves

one channel, 'mag_norm' or 'acc_norm', whose columns are m · X_k. It tells constants and nothing else: what
follows time, temperature or size has no reference here that would not take part of it.

    noise     is that of what the fit leaves, from rest to rest, from direction to direction or of the largest
              octave: the place's field, the hand and the lack of fit are in it, so a norm tells nothing more
    strength  of the field at this place is unknown: a constant of the norm, and a common factor of all scale
              factors with it, are not told
    gyros     have no norm
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus
from gap_diagnosis.belief import TriadBelief
from gap_diagnosis.doubtful_samples import set_aside_in
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.norm_fit import NormFit, fit_norm, mean_radius
from gap_diagnosis.norm_rows import ROWS_PER_REST, attitudes, rests_of
from gap_diagnosis.observation import NoiseBelief, NormView, Observation, SensorOutput, SetAside
from gap_diagnosis.reference_noise import reference_density
from gap_diagnosis.unit_and_stand import ROOM_TEMPERATURE_C, UnitSide, site_of
from gap_diagnosis.unit_outputs import plain_numbers
from protocol.recordings import Recording

STANDARD_GRAVITY_M_S2 = 9.80665
PLAIN_FIELD_T = 50e-6
"""What a mean radius in plain numbers is taken for inside; reports give it back in those numbers."""
LEAST_ATTITUDES, LEAST_FOR_ANGLES = 6, 12
UNTOLD_SCATTER = 1e-3
"""Of gravity, from rest to rest, where fewer than `LEAST_LEFT` rests are left to tell it."""
LEAST_LEFT = 3
LEAST_FIELD_ROWS = 500
LARGEST_MISFIT = 0.15
"""Of the field's strength: beyond, the place's field changes too much for a norm to mean something."""
LARGEST_TURN, MOST_IN_A_MEAN = 0.15, 20
"""rad: the mean of a chord so long is shorter than the field by a thousandth."""
CELLS_PER_RADIUS, LEAST_IN_A_CELL = 2, 10
PAUSE_S = 1.0


@dataclass(frozen=True)
class _Rows:
    """Rows of all recordings, one after the other."""

    time_s: FloatArray
    values_si: FloatArray
    period_s: float
    noise_si: float = 0.0
    unit: tuple[str, float] | None = None


def norm_observations(
    recordings: Sequence[Recording], units: Sequence[UnitSide], predicted: frozenset[SensorName]
) -> list[Observation]:
    """One observation for each triad that no recording predicts and that has rests or turns enough.

    units: of the recordings; predicted: triads that a stand's report predicts in one of them.
    """
    found: list[Observation] = []
    ways: dict[SensorName, Callable[[Sequence[UnitSide]], _Rows | None]] = {"acc": _rests, "mag": _turns}
    for sensor, collect in ways.items():
        rows = None if sensor in predicted else collect(units)
        one = None if rows is None else _observation(recordings, sensor, rows, units[0].beliefs[sensor])
        found += [] if one is None else [one]
    return found


def _rests(units: Sequence[UnitSide]) -> _Rows | None:
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    counts: list[NDArray[np.int64]] = []
    deviations: list[float] = []
    for unit in units:
        triad = unit.triads.get("acc")
        if triad is None or triad.are_means:
            continue
        good = _good("acc", unit, triad.values_si)
        gyro = unit.triads["gyro"].values_si if "gyro" in unit.triads else None
        time_s = unit.rows.time_s[unit.rows.row_of_sample]
        rests = rests_of(time_s, good, gyro, unit.rows.period_s)
        if rests.count:
            times.append(_behind(times, rests.time_s))
            values.append(rests.values_si)
            counts.append(rests.samples)
            deviations.append(rests.deviation_si)
    if not values or attitudes(np.concatenate(values)) < LEAST_ATTITUDES:
        return None
    per_row = float(np.mean(np.concatenate(counts)))
    noise_si = float(np.sqrt(np.mean(np.square(deviations)) / per_row))
    time_s = np.concatenate(times)
    return _Rows(time_s, np.concatenate(values), float(np.median(np.diff(time_s))), noise_si)


def _turns(units: Sequence[UnitSide]) -> _Rows | None:
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    is_plain = False
    for unit in units:
        triad = unit.triads.get("mag")
        samples = triad.values_si if triad is not None else plain_numbers(unit.recording, "mag")
        if samples is None or (times and is_plain != (triad is None)):
            continue
        is_plain = triad is None
        good = _good("mag", unit, samples)
        known = np.isfinite(good).all(axis=1)
        time_s, means = _short_means(unit.rows.time_s[unit.rows.row_of_sample][known], good[known])
        if len(means):
            times.append(_behind(times, time_s))
            values.append(means)
    if not values or sum(map(len, values)) < LEAST_FIELD_ROWS:
        return None
    every = np.concatenate(values)
    radius = mean_radius(every)
    if radius is None:
        return None
    factor = PLAIN_FIELD_T / radius if is_plain else 1.0
    named = ("1", factor) if is_plain else None
    joined_s = np.concatenate(times)
    return _Rows(joined_s, every * factor, float(np.median(np.diff(joined_s))), unit=named)


def _short_means(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of as many samples as turn little: noise of a row acts on its columns too, by its square."""
    middle = 0.5 * (values.max(axis=0) + values.min(axis=0))
    directions = (values - middle) / np.linalg.norm(values - middle, axis=1).mean()
    noise, size = _moved(directions, 1), 1
    while size < MOST_IN_A_MEAN and _moved(directions, size + 1) - noise < LARGEST_TURN**2:
        size += 1
    count = len(values) // size
    means = values[: count * size].reshape(count, size, 3).mean(axis=1)
    return time_s[: count * size].reshape(count, size).mean(axis=1), np.asarray(means, dtype=np.float64)


def _moved(directions: FloatArray, apart: int) -> float:
    """Mean square of the way between samples so far apart, twice the noise's variance in it."""
    if len(directions) <= apart:
        return math.inf
    way: FloatArray = directions[apart:] - directions[:-apart]
    return float(np.einsum("nk,nk->", way, way)) / len(way)


def _good(sensor: str, unit: UnitSide, samples: FloatArray) -> FloatArray:
    belief = unit.beliefs["acc" if sensor == "acc" else "mag"]
    unseen = np.full(samples.shape, np.nan)
    values, _ = set_aside_in(sensor, samples, unseen, belief.range_si, belief.quantum_si)
    return values


def _behind(before: Sequence[FloatArray], time_s: FloatArray) -> FloatArray:
    """The times, moved where they do not follow the recording before."""
    if not before or time_s[0] > before[-1][-1]:
        return time_s
    return time_s + (float(before[-1][-1]) + PAUSE_S - float(time_s[0]))


def _observation(
    recordings: Sequence[Recording], sensor: SensorName, rows: _Rows, belief: TriadBelief
) -> Observation | None:
    named = ", ".join(one.recording_id for one in recordings[:3])
    named += f" and {len(recordings) - 3} more" if len(recordings) > 3 else ""
    count = attitudes(rows.values_si) if sensor == "acc" else len(rows.values_si)
    believed = belief.matrix, belief.bias_si * (rows.unit[1] if rows.unit else 1.0)
    strength_si = _strength(recordings, sensor, rows)
    try:
        fit = fit_norm(
            rows.values_si,
            strength_si,
            *believed,
            cross=sensor == "mag" or count >= LEAST_FOR_ANGLES,
            where=f"recordings {named}, {sensor}",
        )
    except DiagnosisError:
        return None  # too few attitudes: as without rests
    used = fit.used
    noise_si = _noise(sensor, rows, fit, used)
    if sensor == "mag" and noise_si > LARGEST_MISFIT * fit.strength_si:
        return None
    notes = _notes(sensor, rows, fit, strength_si, int((~used).sum()))
    return _seen(recordings, named, sensor, rows, fit, believed, used, noise_si, notes)


def _strength(recordings: Sequence[Recording], sensor: SensorName, rows: _Rows) -> float:
    if sensor == "acc":
        return site_of(recordings[0]).get("gravity_m_s2", STANDARD_GRAVITY_M_S2)
    return mean_radius(rows.values_si) or PLAIN_FIELD_T


def _noise(sensor: SensorName, rows: _Rows, fit: NormFit, used: NDArray[np.bool_]) -> float:
    """Standard deviation of a row that makes independent rows as uncertain as what the fit leaves."""
    left = fit.residual_si[used]
    freedom = math.sqrt(len(left) / max(len(left) - fit.unknowns, 1))
    if sensor == "mag":
        told = reference_density(left, np.zeros(len(left), dtype=np.int64), rows.period_s)
        by_direction = _scatter_of_directions(left, fit.input_si[used], fit.unknowns)
        return max(told / math.sqrt(rows.period_s), float(left.std()) * freedom, by_direction)
    rests = fit.residual_si.reshape(-1, ROWS_PER_REST).mean(axis=1)[
        used.reshape(-1, ROWS_PER_REST).any(axis=1)
    ]
    to_tell = len(rests) - fit.unknowns
    scatter = UNTOLD_SCATTER * fit.strength_si
    if to_tell >= LEAST_LEFT:
        scatter = math.sqrt(float(rests @ rests) / to_tell)
    return max(rows.noise_si, scatter * math.sqrt(ROWS_PER_REST))


def _scatter_of_directions(left: FloatArray, inputs: FloatArray, unknowns: int) -> float:
    """Standard deviation of a row that makes means over cells of direction as uncertain as they scatter."""
    cosines = inputs / np.linalg.norm(inputs, axis=1, keepdims=True)
    cells = np.rint(CELLS_PER_RADIUS * cosines).astype(np.int64) @ np.array([100, 10, 1])
    _, cell = np.unique(cells, return_inverse=True)
    count = np.bincount(cell)
    total = np.bincount(cell, weights=left)
    many = count >= LEAST_IN_A_CELL
    freedom = int(many.sum()) - unknowns
    return math.sqrt(float(np.sum(total[many] ** 2 / count[many])) / freedom) if freedom > 0 else 0.0


def _notes(
    sensor: SensorName, rows: _Rows, fit: NormFit, strength_si: float, outliers: int
) -> list[SetAside]:
    axis = "xyz"[fit.reference]
    found: list[SetAside] = []
    if sensor == "acc":
        rests = len(rows.values_si) // ROWS_PER_REST
        scales = np.diag(fit.matrix) * fit.strength_si / strength_si - 1.0
        said = ", ".join(f"{100.0 * one:+.2f}" for one in scales)
        why = (
            f"seen by its norm in {rests} rests, since no stand tells its motion; scale factors against that "
            f"of {axis}; were gravity {strength_si:.5f} m/s^2, those of x, y, z would be off by {said} %"
        )
    else:
        why = (
            "seen by its norm, since no stand tells the field; scale factors and soft iron (not to be told "
            f"apart) against axis {axis}; field strength and common scale factor are not told"
        )
    found.append(SetAside(f"{sensor}_norm", 0, why))
    if outliers:
        found.append(SetAside(f"{sensor}_norm", outliers, "far from the surface of all others"))
    return found


def _seen(
    recordings: Sequence[Recording],
    named: str,
    sensor: SensorName,
    rows: _Rows,
    fit: NormFit,
    believed: tuple[FloatArray, FloatArray],
    used: NDArray[np.bool_],
    noise_si: float,
    notes: Sequence[SetAside],
) -> Observation:
    change = [*(fit.bias_si - believed[1]), *(fit.matrix[i, j] - believed[0][i, j] for i, j in fit.free)]
    residual = fit.residual_si + fit.columns() @ np.array(change)
    count = len(residual)
    values, predicted = np.full((count, 4), np.nan), np.full((count, 4), np.nan)
    predicted[:, 3] = fit.strength_si
    values[used, 3] = fit.strength_si + residual[used]
    told = tuple(pair for pair in fit.free if pair != (fit.reference, fit.reference))
    view = NormView(fit.along, noise_si, told, rows.unit)
    output = SensorOutput(values, predicted, NoiseBelief(), norm=view)
    stimulus = Stimulus(
        time_s=rows.time_s,
        temperature_c=np.full(count, ROOM_TEMPERATURE_C),
        sample_period_s=rows.period_s,
    )
    acting = {"acc": "specific_force_m_s2", "mag": "field_t"}[sensor]
    first = recordings[0]
    return Observation(
        recording_id=named,
        serial=str(first.unit.get("serial", "")),
        product=str(first.unit.get("product", "")),
        profile=str(first.test.get("profile", "")),
        run=str(first.test.get("run", "")),
        mount=str(first.test.get("mount", "")),
        stand_id=str(first.stand.get("id", "")),
        stand_kind="",
        stimulus=dataclasses.replace(stimulus, **{acting: fit.input_si}),  # pyright: ignore[reportArgumentType]
        has_temperature=False,
        outputs={sensor: output},
        usable=np.ones(count, dtype=bool),
        piece=np.zeros(count, dtype=np.int64),
        sample_period_s=rows.period_s,
        set_aside=tuple(notes),
        believed=first.believed,
    )
