# pyright: strict
"""What a diagnosis hands back: the document of docs/gap.md, and what its page draws."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray

REPORT_FORMAT = "testloom-gap-report/1"
Verdict = Literal["no_gap", "attributed", "confusable", "unattributed"]


@dataclass(frozen=True)
class HeatCell:
    """One cell of the map of where: a channel in a regime."""

    channel: str
    variable: str
    low: float
    high: float
    unit: str
    sigmas: float
    p_adjusted: float


@dataclass(frozen=True)
class ResidualSeries:
    """One channel of one recording, thinned for drawing: values less model, before and after the best set."""

    recording_id: str
    channel: str
    unit: str
    time_s: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Spectrum:
    """Deviation over averaging time, or density over frequency, of one channel's residual."""

    channel: str
    kind: Literal["allan", "psd"]
    unit: str
    abscissa: FloatArray
    before: FloatArray
    after: FloatArray
    believed: FloatArray


@dataclass(frozen=True)
class GapReport:
    """The outcome of a diagnosis.

    Attributes:
        document: report.json.
        effects: those of the most probable set with their fitted parameters, ready for a twin.
        heat, series, spectra: for the page.
        not_used: sentences: what the data could not serve for.
    """

    document: Mapping[str, Any]
    effects: tuple[CatalogueEffect, ...] = ()
    heat: tuple[HeatCell, ...] = ()
    series: tuple[ResidualSeries, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    not_used: tuple[str, ...] = field(default=())

    @property
    def verdict(self) -> Verdict:
        """What it comes to."""
        return self.document["verdict"]
