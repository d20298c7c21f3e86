# pyright: strict
"""What a search for spectral lines works on: a recording's residuals, and what moved in it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.observation import Observation

SensorChannel = tuple[SensorName, int]

LEAST_ROWS = 256
LEAST_SHARE_OF_ROWS = 0.2
MOVING_RATE_RAD_S, STEADY_RATE, LEAST_STEADY = 1e-3, 0.05, 0.3
LEAST_ANGLE_RAD = 0.01
TINY = 1e-9


@dataclass
class LineResiduals:
    """One recording's channels, whose residuals shrink as lines are taken off.

    Attributes:
        observation: of single samples.
        time_s: (n,).
        place: (n,) index of each row on the even grid.
        left: channel → (n,) residual, 0 where unknown.
        known: channel → (n,) bool.
        rotations_hz: turns per second of gimbals that turn evenly.
        removed: channel → (n,) lines taken off.
    """

    observation: Observation
    time_s: FloatArray
    place: NDArray[np.int64]
    left: dict[SensorChannel, FloatArray]
    known: dict[SensorChannel, NDArray[np.bool_]]
    rotations_hz: list[float]
    removed: dict[SensorChannel, FloatArray] = field(default_factory=dict[SensorChannel, FloatArray])

    @property
    def length_s(self) -> float:
        """Of the recording."""
        return float(self.time_s[-1] - self.time_s[0])

    def excitation(self) -> Iterator[FloatArray]:
        """(n,) series of what moved: predictions, their squares, cubes and moduli, waves of the gimbals."""
        for sensor, output in self.observation.outputs.items():
            for axis in range(1 if sensor == "temperature" else 3):
                u = output.predicted_si[:, axis]
                if not np.isfinite(u).any():
                    continue
                u = np.where(np.isfinite(u), u, np.nanmean(u))
                if np.ptp(u) > TINY:
                    yield from (_centred(one) for one in (u, u**2, np.abs(u), u**3))
        for angle in _gimbals(self.observation):
            if np.ptp(angle) > LEAST_ANGLE_RAD:
                yield from (_centred(wave(n * angle)) for wave in (np.sin, np.cos) for n in (1.0, 2.0))


def _gimbals(one: Observation) -> list[FloatArray]:
    """(n,) angle of each; none where the stand does not tell."""
    angles = one.stimulus.angles_rad
    return [] if angles is None else [np.nan_to_num(angles[:, axis]) for axis in range(3)]


def _centred(series: FloatArray) -> FloatArray:
    return series - series.mean()


def line_residuals(one: Observation) -> LineResiduals | None:
    """What bias, matrix and slope leave of each channel; None: too few rows."""
    time_s = one.stimulus.time_s
    if len(time_s) < LEAST_ROWS:
        return None
    place = np.rint((time_s - time_s[0]) / one.sample_period_s).astype(np.int64)
    left: dict[SensorChannel, FloatArray] = {}
    known: dict[SensorChannel, NDArray[np.bool_]] = {}
    for sensor, output in one.outputs.items():
        if sensor == "temperature":
            continue
        predicted = output.predicted_si
        for axis in range(3):
            rows = np.isfinite(output.residual_si[:, axis]) & np.isfinite(predicted).all(axis=1)
            if rows.sum() < max(LEAST_ROWS, LEAST_SHARE_OF_ROWS * len(time_s)):
                continue
            columns = [np.ones(int(rows.sum())), np.gradient(predicted[rows, axis])]
            columns += [predicted[rows, other] for other in range(3)]
            full = np.zeros(len(time_s))
            full[rows] = _left_of(output.residual_si[rows, axis], columns)
            left[sensor, axis], known[sensor, axis] = full, rows
    return LineResiduals(one, time_s, place, left, known, _rotations_hz(one)) if left else None


def _left_of(residual: FloatArray, columns: list[FloatArray]) -> FloatArray:
    x = np.stack([column / max(float(np.abs(column).max()), TINY) for column in columns], axis=1)
    gram = x.T @ x
    gram[np.diag_indices_from(gram)] += 1e-9 * len(x)
    return residual - x @ np.linalg.solve(gram, x.T @ residual)


def _rotations_hz(one: Observation) -> list[float]:
    """Of gimbals that turn at one rate for long."""
    found: list[float] = []
    for angle in _gimbals(one):
        rate = np.diff(angle) / one.sample_period_s
        middle = float(np.median(rate))
        steady = np.abs(rate - middle) < STEADY_RATE * abs(middle)
        if abs(middle) > MOVING_RATE_RAD_S and float(np.mean(steady)) > LEAST_STEADY:
            found.append(abs(middle) / (2.0 * math.pi))
    return found
