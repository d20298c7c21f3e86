# pyright: strict
"""One run of a profile on a stand: what acted at any moment, and what the stand's own instruments said.

Times are seconds since the start of the run, on the bench's clock. Everything is a function of time, exact at
any sample rate: nothing is integrated on a grid, so a recording does not depend on how it is sampled or cut.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import Stimulus

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class EventStream:
    """What a stand reports not at a rate but when it happens: a trigger, a zero crossing of a grating.

    Attributes:
        units: column → unit of measure; 't' first, in s.
        columns: column → (n,).
    """

    name: str
    units: Mapping[str, str]
    columns: Mapping[str, NDArray[Any]]


class Run(Protocol):
    """See the module."""

    @property
    def duration_s(self) -> float:
        """From start to end."""
        ...

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What truly acts on a unit (n,), non-decreasing times, in its nominal body axes.

        `sample_period_s` is left open (NaN): the unit knows how it samples. `temperature_c` is that of what
        the unit is mounted on. What the stand does *beside* its report is not in here: those are the
        stand's effects, which the unit's chain applies.
        """
        ...

    @property
    def reading_units(self) -> Mapping[str, str]:
        """Column → unit of the stand's stream, as in docs/recordings.md, without the time."""
        ...

    @property
    def reading_rate_hz(self) -> float:
        """How often the stand reports."""
        ...

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """What the stand's own encoders and probes say, (n,) each, in `reading_units`."""
        ...

    def events(self) -> tuple[EventStream, ...]:
        """What happened at moments of its own."""
        ...

    @property
    def trigger_times_s(self) -> FloatArray:
        """(k,) edges on the trigger line between stand and unit; the first is the start unless said."""
        ...
