# pyright: strict
"""What effects add at the rows that are compared, without evaluating the rest of a long record.

Where few rows of a record are compared (see `enough_rows`), an effect that remembers nothing needs only
those, and the row before each stretch of them for its rates of change. One that remembers (a lag, a play, a
delay) is evaluated over the whole record and read at these rows. Either way the numbers are the same.
"""

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray, Stimulus
from gap_diagnosis.candidates import regressors
from gap_diagnosis.observation import Observation

FEW = 0.5
"""Share of a record's rows below which cutting them out pays."""


class ComparedRows:
    """The rows of one observation at which regressors are wanted.

    Attributes:
        are_few: whether only compared rows are given, or all.
    """

    def __init__(self, observation: Observation) -> None:
        self._stimulus, self._usable = observation.stimulus, observation.usable
        is_seen_by_norm = any(output.norm is not None for output in observation.outputs.values())
        self.are_few = not is_seen_by_norm and np.count_nonzero(self._usable) < FEW * len(self._usable)

    def among(self, rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which of the rows that `regressors` gives are among `rows` (n,), all of which are compared."""
        return rows[self._usable] if self.are_few else rows

    def regressors(self, effect: CatalogueEffect) -> dict[str, FloatArray] | None:
        """Free scalar → (rows given, 3), as `candidates.regressors`."""
        if not self.are_few:
            return regressors(effect, self._stimulus)
        if effect.remembers:
            columns, inside = regressors(effect, self._stimulus), self._usable
        else:
            columns, inside = regressors(effect, self._cut), self._usable[self._with_the_row_before]
        return None if columns is None else {name: column[inside] for name, column in columns.items()}

    @cached_property
    def _with_the_row_before(self) -> NDArray[np.bool_]:
        wanted = self._usable.copy()
        wanted[:-1] |= self._usable[1:]
        return wanted

    @cached_property
    def _cut(self) -> Stimulus:
        rows = {
            one.name: getattr(self._stimulus, one.name)[self._with_the_row_before]
            for one in dataclasses.fields(self._stimulus)
            if isinstance(getattr(self._stimulus, one.name), np.ndarray)
        }
        return dataclasses.replace(self._stimulus, **rows)
