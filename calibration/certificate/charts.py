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
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from calibration.certificate.rounding import power_of_ten

FONT = "FONT OF THE DOCUMENT"
"""Stands in the SVG where the name of a font family belongs."""
SIZE_IN = (6.7, 2.3)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7a4a8c", "#8a6d1f", "#7a7a7a", "#56b4e9", "#a03048")
MAX_MARKED = 60
"""Beyond as many points a curve has no marks."""
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
    """Points of one curve."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


def curves_chart(
    curves: Sequence[Curve], x_label: str, y_name: str, y_unit: str, by_row: bool = False
) -> str:
    """Curves over one abscissa; axes over more than two decades of positive numbers are logarithmic.

    `y_name`, `y_unit`: may be empty. `by_row`: the abscissa only counts, so points are not joined.
    """
    power = _common_power([value for curve in curves for value in curve.y])
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the layout has its own fonts
        figure = Figure(figsize=SIZE_IN)
        axes: Any = figure.add_axes((0.1, 0.19, 0.72 if len(curves) > 1 else 0.88, 0.68))
        for number, curve in enumerate(curves):
            axes.plot(
                curve.x,
                [value / 10.0**power for value in curve.y],
                "o" if by_row else "o-" if len(curve.x) <= MAX_MARKED else "-",
                color=COLOURS[number % len(COLOURS)],
                markersize=3,
                linewidth=1.1,
                label=curve.label,
            )
        axes.grid(color="0.88", linewidth=0.6)
        axes.set_axisbelow(True)
        for axis, values in (("x", curves[0].x), ("y", [v for curve in curves for v in curve.y])):
            _lay_out(axes, axis, values, whole=by_row and axis == "x")
        axes.set_xlabel(x_label)
        unit = " ".join(filter(None, (power_of_ten(power) if power else "", y_unit)))
        axes.set_title(", ".join(filter(None, (y_name, unit))), loc="left", size=9)
        if len(curves) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.04), frameon=False)
        drawn = io.StringIO()
        FigureCanvasSVG(figure).print_svg(drawn, metadata={"Date": None, "Creator": None})
    return drawn.getvalue().replace("'DejaVu Sans'", f"'{FONT}'")


def _lay_out(axes: Any, name: str, values: Sequence[float], whole: bool) -> None:
    axis = axes.xaxis if name == "x" else axes.yaxis
    if _logarithmic(values):
        (axes.set_xscale if name == "x" else axes.set_yscale)("log")
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(round(math.log10(value)))))
    else:
        axis.set_major_locator(MaxNLocator(nbins=6, integer=whole))


def _logarithmic(values: Sequence[float]) -> bool:
    return min(values) > 0 and max(values) > LOGARITHMIC_FROM * min(values)


def _common_power(values: Sequence[float]) -> int:
    """Power of ten that belongs to the axis's label; 0 where numbers are handy, or logarithmic."""
    largest = max(abs(value) for value in values)
    if largest == 0 or _logarithmic(values) or 1e-2 <= largest < 1e4:
        return 0
    return math.floor(math.log10(largest))
