"""The plots of a report as SVG: small enough for a phone, and without words: one picture for all languages.

The same report gives the same bytes.
"""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from dut_emulator.effects.effect import FloatArray
from dut_emulator.picture_style import COLOURS, GRID, STYLE
from gap_diagnosis.field_units import field_unit, unit_sign
from gap_diagnosis.report import GapReport, ResidualSeries, Spectrum

AFTER, BEFORE, _, BELIEVED = COLOURS
SIZE_IN = (4.4, 2.5)
PANEL = (0.16, 0.17, 0.82, 0.8)
"""Left, bottom, width, height of the axes, in shares of the figure."""
MAX_SERIES, MAX_SPECTRA = 12, 24
BINS = 400
"""A curve of more samples is drawn as the least and the greatest of so many spans."""
_HOURS, _MINUTES = 3.0 * 3600.0, 600.0
_OWN_IDS = re.compile(r' id="(?:figure|patch|axes|line2d|text|matplotlib|xtick|ytick|PathCollection)[^"]*"')


@dataclass(frozen=True)
class Picture:
    """One plot: what it shows, and the file that it is in."""

    shows: ResidualSeries | Spectrum
    file_name: str
    svg: str


def pictures(report: GapReport) -> tuple[Picture, ...]:
    """The plots: residuals that changed most, at most `MAX_SERIES`, then `MAX_SPECTRA` of noise."""
    changed = sorted(report.series, key=lambda one: -_share_gone(one))[:MAX_SERIES]
    chosen = {id(one) for one in changed}
    residuals = (
        Picture(one, f"residual-{_slug(one.recording_id)}-{_slug(one.channel)}.svg", series_svg(one))
        for one in report.series
        if id(one) in chosen
    )
    spectra = (
        Picture(one, f"{one.kind}-{_slug(one.channel)}.svg", spectrum_svg(one))
        for one in report.spectra[:MAX_SPECTRA]
    )
    return (*residuals, *spectra)


def series_svg(series: ResidualSeries) -> str:
    """Residual over time: before, and after over it."""
    finite = np.concatenate([series.before, series.after])
    finite = np.abs(finite[np.isfinite(finite)])
    factor, unit = field_unit(series.unit, float(finite.max(initial=0.0)) or 1.0)
    seconds = float(np.ptp(series.time_s)) if len(series.time_s) else 0.0
    span, name = (3600.0, "h") if seconds > _HOURS else (60.0, "min") if seconds > _MINUTES else (1.0, "s")
    figure, panel = panel_of()
    for values, colour in ((series.before, BEFORE), (series.after, AFTER)):
        time, drawn = _envelope(series.time_s / span, values * factor)
        panel.plot(time, drawn, color=colour, linewidth=0.7)
    panel.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    panel.margins(x=0.01)
    panel.set_xlabel(f"t, {name}")
    panel.set_ylabel(f"Δ, {unit_sign(unit)}")
    return svg_of(figure, f"series {series.recording_id} {series.channel}")


def spectrum_svg(spectrum: Spectrum) -> str:
    """Allan deviation over averaging time, or density over frequency: before, after, believed."""
    curves = (
        (spectrum.believed, BELIEVED, "--", 1.3),
        (spectrum.before, BEFORE, "-", 1.1),
        (spectrum.after, AFTER, "-", 1.1),
    )
    figure, panel = panel_of()
    for values, colour, line, width in curves:
        there = np.isfinite(values) & (values > 0) & (spectrum.abscissa > 0)
        if there.any():
            panel.plot(spectrum.abscissa[there], values[there], color=colour, linestyle=line, linewidth=width)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel("τ, s" if spectrum.kind == "allan" else "f, Hz")
    symbol = "σ(τ)" if spectrum.kind == "allan" else "√S" if "sqrt" in spectrum.unit else "S"
    panel.set_ylabel(f"{symbol}, {unit_sign(spectrum.unit)}")
    return svg_of(figure, f"{spectrum.kind} {spectrum.channel}")


def _share_gone(series: ResidualSeries) -> float:
    before, after = (float(np.nanmean(v**2)) if len(v) else 0.0 for v in (series.before, series.after))
    return 1.0 - after / before if before > 0 and np.isfinite(before) else 0.0


def _envelope(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest of each of `BINS` spans, in the order in which a line shows both."""
    if len(values) <= 2 * BINS:
        return time, values
    edges = np.linspace(0, len(values), BINS + 1).astype(np.int64)
    low, high, at = np.empty(BINS), np.empty(BINS), np.empty(BINS)
    for index, (start, stop) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        part = values[start:stop]
        part = part[np.isfinite(part)]
        low[index], high[index] = (part.min(), part.max()) if len(part) else (np.nan, np.nan)
        at[index] = time[start:stop].mean()
    return np.repeat(at, 2), np.stack([low, high], axis=1).ravel()


def panel_of() -> tuple[Figure, Any]:
    """A figure of the page's size with one set of axes."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN)
        FigureCanvasSVG(figure)
        panel: Any = figure.add_axes(PANEL)
        panel.grid(**GRID)
        return figure, panel


def svg_of(figure: Figure, salt: str) -> str:
    """The figure as an element to stand in a page; text stays text."""
    out = io.StringIO()
    with mpl.rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": salt}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    return _OWN_IDS.sub("", text).strip()


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name)


def legend_colours() -> Sequence[tuple[str, str, bool]]:
    """Word, colour, dashed: what the curves are."""
    return (("before", BEFORE, False), ("after", AFTER, False), ("believed", BELIEVED, True))
