"""Overlapping Allan deviation beside allantools: two hours at 1 kHz, 48 averaging times, the same samples."""

import time
from collections.abc import Callable
from typing import Any

import allantools
import numpy as np

from calibration.algorithms.allan_variance import (
    AllanDeviation,
    logarithmic_taus,
    modified_allan_deviation,
    overlapping_allan_deviation,
)

SAMPLES = 7_200_000
RATE_HZ = 1000.0
TAUS = 50
"""Of which 48 remain when the shortest are rounded to whole samples."""
ROUNDS = 2
RATIO_GOAL = 0.45
AGREEMENT_GOAL = 1e-12


def run() -> list[dict[str, Any]]:
    """The figures."""
    rng = np.random.Generator(np.random.SFC64(1))
    samples = 1e-3 * rng.standard_normal(SAMPLES) + 1e-6 * np.cumsum(rng.standard_normal(SAMPLES)) + 0.1
    taus_s = logarithmic_taus(SAMPLES, RATE_HZ, TAUS)
    figures: list[dict[str, Any]] = []
    for kind, ours, peer in (
        ("overlapping", overlapping_allan_deviation, allantools.oadev),
        ("modified", modified_allan_deviation, allantools.mdev),
    ):
        figures += _beside(kind, ours, peer, samples, taus_s, RATIO_GOAL if kind == "overlapping" else None)
    return figures


def _beside(
    kind: str,
    ours: Callable[..., AllanDeviation],
    peer: Callable[..., Any],
    samples: np.ndarray,
    taus_s: np.ndarray,
    goal: float | None,
) -> list[dict[str, Any]]:
    ours_s, found = _fastest(lambda: ours(samples, RATE_HZ, taus_s))
    peer_s, (_taus, expected, _errors, _terms) = _fastest(lambda: peer(samples, RATE_HZ, "freq", taus_s))
    ratio = ours_s / peer_s
    apart = float(np.abs(found.deviation / expected - 1.0).max())
    beside = f"allantools {peer_s:.2f} s, Testloom {ours_s:.2f} s"
    return [
        {
            "figure": f"{kind} Allan deviation, {len(taus_s)} taus, CPU over allantools'",
            "value": ratio,
            "unit": "1",
            "goal": "" if goal is None else f"at most {goal:g}",
            "met": None if goal is None else ratio <= goal,
            "compared_with": beside,
        },
        {
            "figure": f"{kind} Allan deviation, largest relative difference from allantools",
            "value": apart,
            "unit": "1",
            "goal": f"at most {AGREEMENT_GOAL:g}",
            "met": apart <= AGREEMENT_GOAL,
            "compared_with": "allantools",
        },
    ]


def _fastest(task: Callable[[], Any]) -> tuple[float, Any]:
    """Least CPU time of some rounds, and the last result."""
    durations, result = [], None
    for _ in range(ROUNDS):
        began = time.process_time()
        result = task()
        durations.append(time.process_time() - began)
    return min(durations), result
