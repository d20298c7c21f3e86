# pyright: strict
"""A small line plot as SVG text: the same bytes for the same numbers, without any library."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WIDTH, HEIGHT, SIDE = 480, 250, 320
LEFT, RIGHT, TOP, BOTTOM = 64, 14, 30, 42
COLOURS = ("#1f5fa8", "#c8541a", "#2e8540", "#7a7a7a")
TICKS = 5
ONE_DECADE, FEW_DECADES = 1.0, 2.0
"""A logarithmic axis that is shorter has more ticks inside its decades."""
MARGIN = 0.05
MAX_POINTS = 420


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
        """The picture."""
        width, height = (SIDE, SIDE - LEFT - RIGHT + TOP + BOTTOM) if self.square else (WIDTH, HEIGHT)
        across = _Axis.over([curve.x for curve in self.curves], (LEFT, width - RIGHT), self.logarithmic)
        up = _Axis.over([curve.y for curve in self.curves], (height - BOTTOM, TOP), self.logarithmic)
        if self.square:
            across, up = across.as_wide_as(up), up.as_wide_as(across)
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" font-family="sans-serif" font-size="12">',
            f'<rect width="{width}" height="{height}" fill="#fff"/>',
            *_grid(across, up),
            f'<rect x="{LEFT}" y="{TOP}" width="{width - RIGHT - LEFT}" height="{height - BOTTOM - TOP}" '
            'fill="none" stroke="#444"/>',
            *(
                line
                for curve, colour in zip(self.curves, COLOURS, strict=False)
                for line in _drawn(curve, colour, across, up)
            ),
            *_names(self.curves),
            f'<text x="{(LEFT + width - RIGHT) / 2:g}" y="{height - 8}" text-anchor="middle">'
            f"{escape(self.x_label)}</text>",
            f'<text transform="translate(14 {(TOP + height - BOTTOM) / 2:g}) rotate(-90)" '
            f'text-anchor="middle">{escape(self.y_label)}</text>',
            "</svg>",
        ]
        return "\n".join(parts) + "\n"


@dataclass(frozen=True)
class _Axis:
    """From values to pixels. `low` and `high` are decades when it is logarithmic."""

    low: float
    high: float
    pixels: tuple[int, int]
    logarithmic: bool

    @staticmethod
    def over(values: Sequence[FloatArray], pixels: tuple[int, int], logarithmic: bool) -> "_Axis":
        every = np.concatenate(values)
        every = every[np.isfinite(every)]
        if logarithmic:
            every = np.log10(every)
        low, high = float(every.min()), float(every.max())
        if high - low <= 1e-9 * max(abs(low), abs(high)):
            low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
        margin = MARGIN * (high - low)
        return _Axis(low - margin, high + margin, pixels, logarithmic)

    def as_wide_as(self, other: "_Axis") -> "_Axis":
        """The same middle, the larger width of the two."""
        half, middle = max(self.high - self.low, other.high - other.low) / 2, (self.low + self.high) / 2
        return _Axis(middle - half, middle + half, self.pixels, self.logarithmic)

    def at(self, values: FloatArray) -> FloatArray:
        """Pixels."""
        begin, end = self.pixels
        scaled = np.log10(values) if self.logarithmic else values
        return begin + (scaled - self.low) / (self.high - self.low) * (end - begin)

    def ticks(self) -> list[tuple[float, str]]:
        """Round values inside, with their text."""
        if self.logarithmic:
            decades = range(math.floor(self.low), math.ceil(self.high) + 1)
            width = self.high - self.low
            marks = range(1, 10) if width < ONE_DECADE else (1, 2, 5) if width < FEW_DECADES else (1,)
            values = [mark * 10.0**decade for decade in decades for mark in marks]
            return [(value, f"{value:g}") for value in values if self.low <= math.log10(value) <= self.high]
        rough = (self.high - self.low) / TICKS
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(size * power for size in (1, 2, 5, 10) if size * power >= rough * 0.999)
        first, last = math.ceil(self.low / step), math.floor(self.high / step)
        return [(k * step, f"{k * step:.6g}") for k in range(first, last + 1)]


def _grid(across: _Axis, up: _Axis) -> list[str]:
    (left, right), (bottom, top) = across.pixels, up.pixels
    lines: list[str] = []
    for value, text in across.ticks():
        x = f"{float(across.at(np.array([value]))[0]):.1f}"
        lines.append(f'<path d="M{x} {bottom}V{top}" stroke="#ddd"/>')
        lines.append(f'<text x="{x}" y="{bottom + 15}" text-anchor="middle">{text}</text>')
    for value, text in up.ticks():
        y = float(up.at(np.array([value]))[0])
        lines.append(f'<path d="M{left} {y:.1f}H{right}" stroke="#ddd"/>')
        lines.append(f'<text x="{left - 5}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
    return lines


def _drawn(curve: Curve, colour: str, across: _Axis, up: _Axis) -> list[str]:
    step = max(1, math.ceil(len(curve.x) / MAX_POINTS))
    x, y = across.at(curve.x[::step]), up.at(curve.y[::step])
    seen = np.isfinite(x) & np.isfinite(y)
    if curve.dots:
        points = zip(x[seen], y[seen], strict=True)
        shape = "".join(f"M{px:.1f} {py:.1f}h0" for px, py in points)
        style = 'stroke-width="3.5" stroke-linecap="round"'
    else:
        words: list[str] = []
        for index in np.flatnonzero(seen):
            move = "L" if index and seen[index - 1] else "M"
            words.append(f"{move}{x[index]:.1f} {y[index]:.1f}")
        shape = "".join(words)
        style = 'stroke-width="1.6"' + (' stroke-dasharray="6 4"' if curve.dashed else "")
    return [f'<path d="{shape}" fill="none" stroke="{colour}" {style}/>']


def _names(curves: Sequence[Curve]) -> list[str]:
    lines: list[str] = []
    x = LEFT
    for curve, colour in zip(curves, COLOURS, strict=False):
        lines.append(f'<path d="M{x} 16h16" stroke="{colour}" stroke-width="3"/>')
        lines.append(f'<text x="{x + 21}" y="20">{escape(curve.name)}</text>')
        x += 40 + 7 * len(curve.name)
    return lines
