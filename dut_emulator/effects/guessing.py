# pyright: strict
"""From a residual to parameters: least squares on the basis, with held parameters looked for on a grid.

Out of scope: noise that is not white. Whitening and deciding between effects is diagnosis.
"""

import itertools
from typing import Any, TypeVar, cast

import numpy as np

from dut_emulator.effects.effect import EffectState, FloatArray, Stimulus
from dut_emulator.effects.parameters import scalars, with_values

MAX_GAUSS_NEWTON_STEPS = 12
MAX_SCAN_EVALUATIONS = 40
MAX_SCAN_ROUNDS = 3
_CONVERGED = 1e-12

E = TypeVar("E")


def fitted(effect: E, residual: FloatArray, stimulus: Stimulus) -> E:
    """The effect with the free and scanned parameters that leave the least sum of squares."""
    scanned: dict[str, tuple[float, ...]] = getattr(effect, "scanned", {})
    if not scanned:
        return _with_free_fitted(effect, residual, stimulus)[0]
    best: tuple[float, tuple[float, ...]] | None = None
    for point in itertools.product(*scanned.values()):
        trial = with_values(effect, dict(zip(scanned, point, strict=True)))
        cost = _with_free_fitted(trial, residual, stimulus)[1]
        if best is None or cost < best[0]:
            best = (cost, point)
    assert best is not None  # a grid has points
    at = dict(zip(scanned, best[1], strict=True))
    for _ in range(MAX_SCAN_ROUNDS if len(scanned) > 1 else 1):
        for name, grid in scanned.items():
            at[name] = _refined(effect, at, name, grid, residual, stimulus)
    return _with_free_fitted(with_values(effect, at), residual, stimulus)[0]


def unexplained(effect: Any, residual: FloatArray, stimulus: Stimulus) -> float:
    """The sum of squares that an effect, as it is, leaves of a residual."""
    idle = np.random.Generator(np.random.SFC64(0))
    samples = stimulus.true_input(effect.sensor)
    return _unexplained(effect, residual, samples, stimulus, idle, np.isfinite(residual))[1]


def _refined(
    effect: Any,
    at: dict[str, float],
    name: str,
    grid: tuple[float, ...],
    residual: FloatArray,
    stimulus: Stimulus,
) -> float:
    """One held parameter between the neighbours of its best point on the grid."""
    # loaded here: who only applies effects does not wait for it
    from scipy.optimize import minimize_scalar  # pyright: ignore[reportUnknownVariableType, reportMissingTypeStubs]

    nearest = min(range(len(grid)), key=lambda index: abs(grid[index] - at[name]))
    low, high = grid[max(nearest - 1, 0)], grid[min(nearest + 1, len(grid) - 1)]

    def cost(value: float) -> float:
        return _with_free_fitted(with_values(effect, {**at, name: float(value)}), residual, stimulus)[1]

    options = {"maxiter": MAX_SCAN_EVALUATIONS, "xatol": 1e-7 * (high - low)}
    found = cast("Any", minimize_scalar(cost, bounds=(low, high), method="bounded", options=options))
    return float(found.x) if found.fun <= cost(at[name]) else at[name]


def _with_free_fitted(effect: E, residual: FloatArray, stimulus: Stimulus) -> tuple[E, float]:
    """Gauss–Newton on the free parameters; one step where the effect is linear. Also the sum of squares."""
    current: Any = effect
    samples = stimulus.true_input(current.sensor)
    idle = np.random.Generator(np.random.SFC64(0))  # a deterministic effect draws nothing from it
    use = np.isfinite(residual)
    left, cost = _unexplained(current, residual, samples, stimulus, idle, use)
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        columns: dict[str, FloatArray] = current.basis(stimulus)
        if not columns:
            return current, cost
        design = np.stack([column[use] for column in columns.values()], axis=1)
        scale = np.sqrt(np.sum(design**2, axis=0))
        scale[scale == 0] = 1.0
        solution = cast("Any", np.linalg.lstsq(design / scale, left, rcond=1e-10))[0]
        step: FloatArray = solution / scale
        change: dict[str, float] = dict(zip(columns, step.tolist(), strict=True))
        trial = with_values(
            current,
            {
                scalar.name: float(np.clip(scalar.value + change[scalar.name], scalar.low, scalar.high))
                for scalar in scalars(current, free_only=True)
            },
        )
        new_left, new_cost = _unexplained(trial, residual, samples, stimulus, idle, use)
        if not new_cost < cost:
            return current, cost
        improved = cost - new_cost
        current, left, cost = trial, new_left, new_cost
        if improved <= _CONVERGED * cost:
            break
    return current, cost


def _unexplained(
    effect: Any,
    residual: FloatArray,
    samples: FloatArray,
    stimulus: Stimulus,
    idle: np.random.Generator,
    use: Any,
) -> tuple[FloatArray, float]:
    out = effect.apply(samples, stimulus, idle, EffectState())
    left = (residual - (out - samples))[use]
    return left, float(left @ left)
