"""A picture of a unit's life: each quantity over time, with its line and what lies beside it."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from calibration.records.derived_units import written_unit
from calibration.records.history import QuantityHistory
from cli.picture_style import picture_style
from dut_emulator.picture_style import COLOURS, GRID
from protocol.errors import Fault, TestloomError
from protocol.language import say

COLUMNS = 3
PANEL_IN = (4.2, 2.6)
DOTS_PER_INCH = 110
MAX_PANELS = 60
EXPANDED = 2.0
_LINE, _OUTLIER = COLOURS[:2]


def write_history_plot(histories: Sequence[QuantityHistory], path: Path) -> None:
    """Write a PNG.

    Raises:
        TestloomError: too many quantities for one picture.
        OSError: the disk refuses.
    """
    if len(histories) > MAX_PANELS:
        raise TestloomError(
            f"{len(histories)} quantities are too many for one picture: at most {MAX_PANELS}.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="name the records of one unit or of one sensor.",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(picture_style()):
        unfinished = path.with_name(f".{path.name}.part")
        FigureCanvasAgg(_figure(histories)).print_png(unfinished)
        unfinished.replace(path)


def _figure(histories: Sequence[QuantityHistory]) -> Figure:
    columns = min(COLUMNS, len(histories))
    rows = -(-len(histories) // columns)
    width, height = PANEL_IN
    figure = Figure(figsize=(width * columns, height * rows), dpi=DOTS_PER_INCH, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(histories) :]:
        panel.set_axis_off()
    for panel, history in zip(panels, histories, strict=False):
        years = history.years()
        values = np.array([point.value for point in history.points])
        expanded = EXPANDED * np.array([point.standard_uncertainty for point in history.points])
        beside = np.array([point.outlier for point in history.points])
        for chosen, colour in ((~beside, _LINE), (beside, _OUTLIER)):
            if chosen.any():
                drawn = {"fmt": "o", "markersize": 4, "capsize": 2, "color": colour}
                panel.errorbar(years[chosen], values[chosen], expanded[chosen], **drawn)
        if history.trend.drift_per_year is not None:
            along = np.linspace(years.min(), years.max(), 50)
            line, of_line = history.trend.at(along)
            panel.plot(along, line, color=_LINE)
            panel.fill_between(
                along,
                line - EXPANDED * of_line,
                line + EXPANDED * of_line,
                color=_LINE,
                alpha=0.15,
                linewidth=0,
            )
        panel.set_title(f"{history.serial} {history.sensor}: {history.name}")
        panel.set_xlabel(say("years after {date}, k = 2", date=history.points[0].time.date().isoformat()))
        panel.set_ylabel(written_unit(history.unit))
        panel.ticklabel_format(axis="y", useOffset=False)
        panel.grid(**GRID)
    return figure
