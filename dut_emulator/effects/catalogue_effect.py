# pyright: strict
# ruff: noqa: ARG002  one signature for every effect: most need only a part of it
"""What every effect of the catalogue can do beyond being applied: say its basis, and be guessed.

    y = u + Σ_k a_k X_k(u, stimulus; φ)

a are the free parameters, φ the held ones (a time constant, a width), X the regressors. An effect of this
form only says its regressors: `apply`, `basis` and `guess` follow. `basis` is the derivative of `apply`
with respect to each free parameter when the triad sees its true input; `guess` finds the parameters, φ
included, that explain a residual best.

The residual that `guess` gets is what the triad gave less what an ideal one would have given; a row with a
value that is not a number is a sample that is missing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np

from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.guessing import fitted
from dut_emulator.effects.parameters import scalars

TRIADS: tuple[SensorName, ...] = ("gyro", "acc", "mag")

Self = TypeVar("Self", bound="CatalogueEffect")


@dataclass(frozen=True)
class CatalogueEffect:
    """The base of every effect: a frozen object of parameters.

    Class attributes: `word` and `stage`; `origin`, what its name begins with when that is not the triad
    ('stand', 'link', 'gnss'); `sensors`, the triads it may act on; `valid`, its limits of validity; `start`,
    the fields that a fit begins with; `scanned`, the held scalars that a fit looks for and where;
    `excludes`, words of effects that describe the same thing another way; `remembers`, whether a sample
    depends on more of the past than the sample before it (a lag, a play, a delay).
    """

    sensor: SensorName
    word: ClassVar[str]
    stage: ClassVar[Stage]
    origin: ClassVar[str] = ""
    sensors: ClassVar[tuple[SensorName, ...]] = TRIADS
    valid: ClassVar[str] = ""
    start: ClassVar[dict[str, Any]] = {}
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {}
    excludes: ClassVar[tuple[str, ...]] = ()
    stochastic: ClassVar[bool] = False
    remembers: ClassVar[bool] = False

    @property
    def is_neutral(self) -> bool:
        """True if these parameters change nothing: all free ones are 0."""
        return self._is_at_zero

    @cached_property
    def _is_at_zero(self) -> bool:
        return not any(scalar.value for scalar in scalars(self, free_only=True))

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3); the input stays as it is."""
        raise NotImplementedError

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Free scalar → (n, 3): the derivative of `apply` to the true input at these parameters."""
        raise NotImplementedError

    def guess(self: Self, residual: FloatArray, stimulus: Stimulus) -> Self:
        """These parameters fitted to a residual (n, 3), beginning from `self`."""
        return fitted(self, residual, stimulus)


@dataclass(frozen=True)
class LinearEffect(CatalogueEffect):
    """An effect that is linear in its free parameters; a subclass says its regressors."""

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """Field → what its amplitude multiplies.

        A triple with (n, 3) or (n, 1) acts axis by axis, a triple with (3, n, 3) gives each component a
        pattern over all axes, a matrix with (n, 3) is a product M x, rows (k, 3) with (k, n, 3 or 1) are
        powers, a number with (n, 3) is a common factor.
        """
        raise NotImplementedError

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        out = self.added_up(self.regressors(samples, stimulus, state))
        out += samples
        return out

    def added_up(self, regressors: dict[str, FloatArray]) -> FloatArray:
        """(n, 3) Σ a_k X_k with these parameters."""
        parts = (contribution(np.asarray(getattr(self, name)), x) for name, x in regressors.items())
        total = next(parts)
        for part in parts:
            total += part
        return total

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Free scalar → (n, 3)."""
        samples = stimulus.true_input(self.sensor)
        patterns = self.regressors(samples, stimulus, EffectState())
        columns: dict[str, FloatArray] = {}
        for scalar in scalars(self, free_only=True):
            one = np.zeros_like(np.asarray(getattr(self, scalar.field), dtype=np.float64))
            one[scalar.index] = 1.0
            columns[scalar.name] = contribution(one, patterns[scalar.field])
        return columns


def contribution(amplitude: FloatArray, regressor: FloatArray) -> FloatArray:
    """(n, 3) amplitude times regressor, by the rules of `LinearEffect.regressors`.

    Term by term, so that chunks of any length round alike.
    """
    product = np.empty((regressor.shape[-2], 3), order="F")
    if regressor.ndim == 2 and amplitude.ndim < 2:
        return np.multiply(regressor, amplitude, out=product)
    for axis, row in enumerate(product.T):
        if regressor.ndim == 3:  # components or powers, each with a pattern of its own
            terms = regressor[:, :, min(axis, regressor.shape[-1] - 1)]
            shares = amplitude if amplitude.ndim == 1 else amplitude[:, axis]
        else:
            terms, shares = regressor.T, amplitude[axis]
        _add_up(terms, shares, row)
    return product


def _add_up(terms: FloatArray, shares: FloatArray, row: FloatArray) -> None:
    """Into `row` (n,) the sum of the terms (k, n), each times its share."""
    acting = [(term, share) for term, share in zip(terms, shares.tolist(), strict=True) if share]
    if not acting:
        row[:] = 0.0
        return
    (term, share), *others = acting
    np.multiply(term, share, out=row)
    for term, share in others:
        row += term * share
