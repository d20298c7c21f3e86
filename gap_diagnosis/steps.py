# pyright: strict
"""A step of one channel at one moment, with nothing that acted beside it: not in the catalogue.

What bias and matrix leave, in means of `ROW_S`, is compared over windows before and behind each moment with
sign(t) − 1.5 t / W: a step shows, a slope and a curve do not. What the steps of the stimulus (rates, forces,
field, temperature, supply: means and largest moduli) tell of it by least squares is taken off, and moments
count at which the stimulus is nearly the same before and behind. The scale is that of the same statistic over
the whole recording, so that slow noise is part of it. An effect that acts by more than that makes steps too:
a step only describes what no effect explains.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from dut_emulator.effects.effect import SI_UNIT, FloatArray
from gap_diagnosis.observation import AXES, Observation, Oddity, SensorOutput

ROW_S = 0.5
WINDOWS_S = (5.0, 10.0, 20.0)
LEAST_WINDOWS = 8
"""Windows in a recording: fewer tell no scale."""
LEAST_SIGMAS = 7.0
UNCHANGED = 0.04
"""Of the stimulus's span."""
SETTLED = 0.5
"""Of the step: what it still is in the farther halves of its windows."""

BoolArray = NDArray[np.bool_]


def steps_in(one: Observation) -> list[Oddity]:
    """The clearest step of each triad, where there is one."""
    size = max(1, round(ROW_S / one.sample_period_s))
    rows = len(one) // size
    if rows < 4 * LEAST_WINDOWS:
        return []
    row_s = size * one.sample_period_s
    stimulus = _stimulus(one, size, rows)
    time_s = _means(one.stimulus.time_s, size, rows)
    found: list[Oddity] = []
    for sensor, output in one.outputs.items():
        if sensor == "temperature":
            continue
        channels = [_left(output, axis, size, rows) for axis in range(3)]
        best: tuple[float, Oddity] | None = None
        for window_s in WINDOWS_S:
            width = round(window_s / row_s)
            if rows < LEAST_WINDOWS * width:
                continue
            quiet = _unchanged(stimulus, width)
            for axis, left in enumerate(channels):
                seen = None if left is None else _clearest(left, stimulus, quiet, width)
                if seen is None:
                    continue
                sigmas, at, step = seen
                p = float(erfc(sigmas / math.sqrt(2.0))) * 6.0 * rows  # pyright: ignore[reportUnknownArgumentType]
                name = f"{sensor}_{AXES[axis]}"
                said = f"a step of {step:.3g} {SI_UNIT[sensor]} on {name} at {time_s[at]:.1f} s"
                if best is None or sigmas > best[0]:
                    best = sigmas, Oddity(said, name, min(p, 1.0), is_certain=False)
        if best is not None:
            found.append(best[1])
    return found


def _means(values: FloatArray, size: int, rows: int) -> FloatArray:
    return values[: rows * size].reshape(rows, size).mean(axis=1)


def _stimulus(one: Observation, size: int, rows: int) -> list[FloatArray]:
    """Means and largest of what acted, each over its span; nothing that stays as it is."""
    series: list[FloatArray] = []
    s = one.stimulus
    for values in (s.rate_rad_s, s.specific_force_m_s2, s.field_t, s.supply_v, s.supply_current_a):
        if values is None:
            continue
        for column in values.reshape(len(one), -1).T:
            known = np.nan_to_num(column)
            series.append(_means(known, size, rows))
            series.append(np.abs(known[: rows * size]).reshape(rows, size).max(axis=1))
    series.append(_means(np.nan_to_num(s.temperature_c), size, rows))
    return [x / np.ptp(x) for x in series if np.ptp(x) > 1e-9 * float(np.abs(x).max())]


def _left(output: SensorOutput, axis: int, size: int, rows: int) -> FloatArray | None:
    """(rows,) what bias and matrix leave; None where too much is missing."""
    residual = output.residual_si[:, axis]
    known = np.isfinite(residual) & np.isfinite(output.predicted_si).all(axis=1)
    if known.mean() < 0.9:
        return None
    x = np.column_stack([np.ones(int(known.sum())), output.predicted_si[known]])
    x /= np.maximum(np.abs(x).max(axis=0), 1e-12)
    gram = x.T @ x
    gram[np.diag_indices_from(gram)] += 1e-9 * len(x)
    full = np.zeros(len(residual))
    full[known] = residual[known] - x @ np.linalg.solve(gram, x.T @ residual[known])
    return _means(full, size, rows)


def _unchanged(stimulus: list[FloatArray], width: int) -> BoolArray:
    """(rows − 2 width + 1,) moments before and behind which the same acted."""
    moments = np.ones(len(stimulus[0]) - 2 * width + 1 if stimulus else 0, dtype=bool)
    for series in stimulus:
        total = np.concatenate([[0.0], np.cumsum(series)])
        mean = (total[width:] - total[:-width]) / width
        moments &= np.abs(mean[width:] - mean[:-width]) < UNCHANGED
    return moments


def _clearest(
    left: FloatArray, stimulus: list[FloatArray], quiet: BoolArray, width: int
) -> tuple[float, int, float] | None:
    """Sigmas, row and size of the clearest step at a quiet moment."""
    place = (np.arange(2 * width) - width + 0.5) / width
    template = np.sign(place) - 1.5 * place
    template /= float(template @ np.sign(place))
    response = 2.0 * np.correlate(left, template, mode="valid")
    if stimulus:
        acted = np.stack([np.correlate(one, template, mode="valid") for one in stimulus], axis=1)
        response = response - acted @ np.linalg.lstsq(acted, response, rcond=1e-6)[0]
    else:
        quiet = np.ones(len(response), dtype=bool)
    scale = 1.4826 * float(np.median(np.abs(response)))
    quiet_rows = np.flatnonzero(quiet)
    if scale <= 0 or len(quiet_rows) < 2 * LEAST_WINDOWS:
        return None
    at = int(quiet_rows[np.argmax(np.abs(response[quiet_rows]))])
    sigmas, step = abs(float(response[at])) / scale, float(response[at])
    half = width // 2
    early, late = left[at : at + half].mean(), left[at + 2 * width - half : at + 2 * width].mean()
    if sigmas < LEAST_SIGMAS or abs(late - early) < SETTLED * abs(step) or (late - early) * step < 0:
        return None
    return sigmas, at + width, step
