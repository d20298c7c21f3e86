"""A line plot as SVG: the same numbers make the same picture, on every day and every machine."""

import io
import math
import re
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from dut_emulator.picture_style import COLOURS, GRID, STYLE

FloatArray = NDArray[np.float64]

SIZE_IN, SQUARE_SIZE_IN = (6.6, 3.4), (4.4, 4.2)
AXES_PLACE = (0.14, 0.16, 0.83, 0.73)
"""Left, bottom, width, height, of the figure: nothing depends on how wide a font makes its texts."""
MAX_POINTS = 260
FEW_DECADES = 2.0
"""A logarithmic axis that is shorter has ticks inside its decades."""
_VERTEX = re.compile(r"([ML] -?\d+\.\d)\d+( -?\d+\.\d)\d+")
"""A vertex of a path, in points, of which less than a tenth cannot be seen."""
_SVG: Any = {"svg.fonttype": "none", "svg.hashsalt": "testloom", "path.simplify": False}


@dataclass(frozen=True)
class Curve:
    """A line with a name, or dots."""

    name: str
    x: FloatArray
    y: FloatArray
    dots: bool = False
    dashed: bool = False


@dataclass(frozen=True)
class Plot:
    """Curves over two axes with labels. `logarithmic` holds for both; `square`: one scale for both."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    logarithmic: bool = False
    square: bool = False

    def svg(self) -> str:
        """The picture. Curves of more than `MAX_POINTS` are thinned out."""
        written = io.StringIO()
        with mpl.rc_context(STYLE), mpl.rc_context(_SVG):
            canvas: Any = FigureCanvasSVG(self._figure())
            canvas.print_svg(written, metadata={"Date": None, "Creator": None})
        return _VERTEX.sub(r"\1\2", written.getvalue())

    def _figure(self) -> Figure:
        figure: Any = Figure(figsize=SQUARE_SIZE_IN if self.square else SIZE_IN)
        axes = figure.add_axes(AXES_PLACE)
        for curve, colour in zip(self.curves, COLOURS, strict=False):
            line = "none" if curve.dots else "--" if curve.dashed else "-"
            marker = "." if curve.dots else None
            axes.plot(
                *_thinned(curve),
                **{"color": colour, "label": curve.name, "linestyle": line, "marker": marker},
            )
        if self.logarithmic:
            _set_logarithmic(axes)
        if self.square:
            axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel=self.x_label, ylabel=self.y_label)
        axes.tick_params(which="both", length=0)
        axes.grid(**GRID)
        axes.legend(ncols=len(COLOURS), frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
        return figure


def _thinned(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Every so many points, and every gap."""
    step = max(1, math.ceil(len(curve.x) / MAX_POINTS))
    kept = (np.arange(len(curve.x)) % step == 0) | np.isnan(curve.y)
    return curve.x[kept], curve.y[kept]


def _set_logarithmic(axes: Any) -> None:
    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        marks = (1, 2, 5) if math.log10(high / low) < FEW_DECADES else (1,)
        axis.set_major_locator(LogLocator(subs=marks))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
