"""Curves as SVG, from numbers alone: the same numbers give the same bytes.

Texts stay texts, and are set in the document's own fonts afterwards.
"""

import io
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from calibration.certificate.rounding import power_of_ten

FONT = "FONT OF THE DOCUMENT"
"""Stands in the SVG where the name of a font family belongs."""
SIZE_IN = (6.7, 2.3)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7a4a8c", "#8a6d1f", "#7a7a7a", "#56b4e9", "#a03048")
MAX_MARKED = 60
"""Beyond as many points a curve has no marks."""
FEW_DECADES = 2.0
"""Over fewer, a logarithmic axis has ticks within a decade too."""
LOGARITHMIC_FROM = 100.0
"""Ratio of the largest to the smallest of numbers that are all positive."""
_STYLE: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "svg.fonttype": "none",
    "svg.hashsalt": "testloom",
}


@dataclass(frozen=True)
class Curve:
    """Points of one curve. `bars`: half their lengths, or none."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    bars: tuple[float, ...] = ()


def curves_chart(
    curves: Sequence[Curve],
    x_label: str,
    y_name: str,
    y_unit: str,
    by_row: bool = False,
    decades: str = "",
    linear: bool = False,
) -> str:
    """Curves over one abscissa; axes over more than two decades of positive numbers are logarithmic.

    `y_name`, `y_unit`: may be empty. `by_row`: the abscissa only counts, so points are not joined.
    `decades`: axes that are read in decades, even over one: 'x', 'xy'. `linear`: no axis is logarithmic.
    """
    power = _common_power([value for curve in curves for value in curve.y], linear)
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the layout has its own fonts
        figure = Figure(figsize=SIZE_IN)
        axes: Any = figure.add_axes((0.1, 0.19, 0.88 - _legend_width(curves), 0.68))
        for number, curve in enumerate(curves):
            scaled_bars = [bar / 10.0**power for bar in curve.bars]
            axes.errorbar(
                curve.x,
                [value / 10.0**power for value in curve.y],
                yerr=scaled_bars or None,
                fmt="o" if by_row else "o-" if len(curve.x) <= MAX_MARKED else "-",
                color=COLOURS[number % len(COLOURS)],
                markersize=3,
                linewidth=1.1,
                elinewidth=0.7,
                capsize=1.5,
                label=curve.label,
            )
        axes.grid(color="0.88", linewidth=0.6)
        axes.set_axisbelow(True)
        for axis, values in (("x", curves[0].x), ("y", [v for curve in curves for v in curve.y])):
            _lay_out(axes, axis, values, whole=by_row and axis == "x", decades=axis in decades, linear=linear)
        axes.set_xlabel(x_label)
        unit = " ".join(filter(None, (power_of_ten(power) if power else "", y_unit)))
        axes.set_title(", ".join(filter(None, (y_name, unit))), loc="left", size=9)
        if len(curves) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.04), frameon=False)
        drawn = io.StringIO()
        FigureCanvasSVG(figure).print_svg(drawn, metadata={"Date": None, "Creator": None})
    return drawn.getvalue().replace("'DejaVu Sans'", f"'{FONT}'")


def _legend_width(curves: Sequence[Curve]) -> float:
    """Part of the figure's width: by the longest label, a letter of East Asia as wide as two."""
    if len(curves) < 2:
        return 0.0
    return 0.06 + 0.0115 * max(sum(2 if ord(one) > 0x2E80 else 1 for one in c.label) for c in curves)


def _lay_out(axes: Any, name: str, values: Sequence[float], whole: bool, decades: bool, linear: bool) -> None:
    axis = axes.xaxis if name == "x" else axes.yaxis
    wide = _logarithmic(values) and not linear
    if wide or (decades and min(values) > 0):
        (axes.set_xscale if name == "x" else axes.set_yscale)("log")
        axis.set_minor_locator(NullLocator())
        if math.log10(max(values) / min(values)) < FEW_DECADES:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        else:
            axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(round(math.log10(value)))))
    else:
        axis.get_major_formatter().set_useOffset(False)
        axis.set_major_locator(MaxNLocator(nbins=6, integer=whole, steps=[1, 2, 2.5, 5, 10]))


def _logarithmic(values: Sequence[float]) -> bool:
    return min(values) > 0 and max(values) > LOGARITHMIC_FROM * min(values)


def _common_power(values: Sequence[float], linear: bool) -> int:
    """Power of ten that belongs to the axis's label; 0 where numbers are handy, or logarithmic."""
    largest = max(abs(value) for value in values)
    if largest == 0 or (_logarithmic(values) and not linear) or 1e-2 <= largest < 1e4:
        return 0
    return math.floor(math.log10(largest))
