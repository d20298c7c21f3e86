# pyright: strict
"""How all pictures look, those of the documents and those of the command line: settings of matplotlib."""

from typing import Any, Final

STYLE: Final[Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": False,
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "lines.linewidth": 1.3,
}
COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#7a7a7a")
"""Okabe and Ito for x, y, z, told apart by everyone and in print; grey for what is beside them."""
GRID: Final[dict[str, Any]] = {"color": "0.88", "linewidth": 0.6}
