"""Repeatability of a figure over runs: standard deviation (GJB 2426A: 零偏重复性, 标度因数重复性).

Without a power cycle between the runs, or with one: turn-on repeatability (IEEE 528: run-to-run).
"""

# pyright: strict
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.bias_figures import BiasFigure, TrueInput, bias, scatter_interval
from calibration.algorithms.correlated_fit import FloatArray, refused

REPEATABILITY_RUNS = 6
REPEATABILITY_DURATION_S = 600.0

Condition = Literal["same_power_on", "each_power_on"]


@dataclass(frozen=True)
class Repeatability:
    """Standard deviation of a figure over runs.

    Attributes:
        repeatability: s of the runs' values, shape (m,).
        beyond_noise: sqrt(max(s^2 - mean u^2, 0)): what the runs differ by beyond their own uncertainty.
        beyond_noise_resolved: whether s^2 is above mean u^2 by more than 95 % of chance, shape (m,).
        mean: of the runs, shape (m,).
        of_quantum: what quanta hide of a run's value, root mean square over the runs, shape (m,).
        runs: how many.
        condition: with or without a power cycle between runs.
    """

    repeatability: FloatArray
    beyond_noise: FloatArray
    beyond_noise_resolved: FloatArray
    mean: FloatArray
    of_quantum: FloatArray
    runs: int
    condition: Condition

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Of s, for normal values: s / sqrt(2 (Q - 1)), 32 % with six runs; with the quantum's part, (m,)."""
        return np.hypot(self.repeatability / math.sqrt(2.0 * (self.runs - 1)), self.of_quantum)

    def interval(self, probability: float) -> FloatArray:
        """Where the standard deviation lies, shape (m, 2): chi-square with Q - 1 degrees of freedom."""
        freedom = np.full(len(self.repeatability), self.runs - 1.0)
        return scatter_interval(self.repeatability, freedom, probability, self.of_quantum)


def repeatability(
    values: FloatArray,
    standard_uncertainty: FloatArray,
    condition: Condition,
    *,
    of_quantum: FloatArray | float = 0.0,
    least_runs: int = REPEATABILITY_RUNS,
    where: str = "repeatability",
) -> Repeatability:
    """Of biases or scale factors over runs (GJB 2426A: at least six).

    Args:
        values: shape (Q, m), one row a run.
        standard_uncertainty: of each value by noise inside its run, shape (Q, m).
        condition: what lay between the runs.
        of_quantum: part of it that each value's quantum has, shape (Q, m) or one for all.
        least_runs: fewer are refused.
        where: for errors.

    Raises:
        CalibrationError: too few runs, or values that are missing.
    """
    values, doubt = np.atleast_2d(values), np.atleast_2d(standard_uncertainty)
    if len(values) < max(least_runs, 2):
        raise refused(
            f"{len(values)} runs carry no repeatability; {max(least_runs, 2)} are asked for.",
            where,
            "record more runs; a run that failed has to be repeated, not left out.",
        )
    if values.shape != doubt.shape or not (np.isfinite(values).all() and np.isfinite(doubt).all()):
        raise refused("A run's value or its uncertainty is missing.", where, "repeat that run.")
    variance = values.var(axis=0, ddof=1)
    noise = np.mean(doubt**2, axis=0)
    freedom = len(values) - 1
    chance = float(chdtri(freedom, 0.05)) / freedom
    return Repeatability(
        repeatability=np.sqrt(variance),
        beyond_noise=np.sqrt(np.maximum(variance - noise, 0.0)),
        beyond_noise_resolved=variance > chance * noise,
        mean=values.mean(axis=0),
        of_quantum=np.sqrt(np.mean(np.broadcast_to(of_quantum, values.shape) ** 2, axis=0)),
        runs=len(values),
        condition=condition,
    )


def bias_repeatability(
    runs: Sequence[tuple[FloatArray, FloatArray]],
    true_input: TrueInput | Sequence[TrueInput],
    condition: Condition,
    *,
    duration_s: float = REPEATABILITY_DURATION_S,
    range_limit: float | None = None,
    of_quantum: FloatArray | float = 0.0,
    where: str = "bias repeatability",
) -> tuple[Repeatability, tuple[BiasFigure, ...]]:
    """From the records (time (n,), output (n, m)) of each run, by default six of ten minutes.

    `true_input`: what truly acted, in all runs or in each. A run's own uncertainty here is that of its mean:
    what wanders between runs is the repeatability. `of_quantum`: see `bias`, (Q, m) or one for all.

    Raises:
        CalibrationError: as `bias` and `repeatability`; the run is named.
    """
    acted = [true_input] * len(runs) if isinstance(true_input, TrueInput) else list(true_input)
    channels = runs[0][1].shape[1] if runs else 0
    quanta = np.asarray(np.broadcast_to(of_quantum, (len(runs), channels)), dtype=np.float64)
    figures = tuple(
        bias(
            time_s,
            output,
            truth,
            duration_s=duration_s,
            range_limit=range_limit,
            known_slow=(),
            of_quantum=quantum,
            where=f"{where}, run {number}",
        )
        for number, ((time_s, output), truth, quantum) in enumerate(
            zip(runs, acted, quanta, strict=True), start=1
        )
    )
    values = np.array([figure.bias for figure in figures]).reshape(len(figures), -1)
    noise = np.reshape([figure.of_mean for figure in figures], values.shape)
    return repeatability(values, noise, condition, of_quantum=quanta, where=where), figures
