# pyright: strict
"""Drawings as SVG, from numbers alone: the same numbers give the same bytes.

Texts stay texts and are set in the document's own fonts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from html import escape

from calibration.certificate.rounding import SUPERSCRIPTS

WIDTH, HEIGHT = 520.0, 185.0
LEFT, RIGHT, TOP, BOTTOM = 62.0, 12.0, 24.0, 36.0
COLOURS = ("#1f4e79", "#c05a1c", "#3c7a3c", "#7a4a8c", "#8a6d1f", "#4a4a4a", "#2a8c8c", "#a03048")
MAX_MARKED = 60
"""Beyond as many points a curve has no marks."""
_TICKS = 5


@dataclass(frozen=True)
class Curve:
    """Points of one curve."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class _Scale:
    """Numbers → places on the paper."""

    low: float
    high: float
    start: float
    end: float
    logarithmic: bool
    counts: bool = False

    def place(self, value: float) -> float:
        value = math.log10(value) if self.logarithmic else value
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self) -> list[tuple[float, str]]:
        """Round numbers and their labels."""
        if self.logarithmic:
            decades = range(math.ceil(self.low - 1e-9), math.floor(self.high + 1e-9) + 1)
            step = max(1, len(decades) // 7)
            return [(10.0**k, "10" + str(k).translate(SUPERSCRIPTS)) for k in decades[::step]]
        step = _round_step((self.high - self.low) / _TICKS)
        step = math.ceil(step) if self.counts else step
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        places = max(0, -int(Decimal(f"{step:.6g}").normalize().as_tuple().exponent))
        return [(k * step, f"{k * step + 0.0:.{places}f}".replace("-", "−")) for k in range(first, last + 1)]


def curves_chart(curves: Sequence[Curve], x_label: str, y_label: str, by_row: bool = False) -> str:
    """Curves over one abscissa; axes over more than two decades of positive numbers are logarithmic.

    `by_row`: the abscissa only counts, so points are not joined.
    """
    xs = [value for curve in curves for value in curve.x]
    ys = [value for curve in curves for value in curve.y]
    across = replace(_scale(xs, LEFT, WIDTH - RIGHT, margin=0.03), counts=by_row)
    power = _common_power(ys)
    factor = 10.0**-power
    up = _scale([value * factor for value in ys], HEIGHT - BOTTOM, TOP, margin=0.08)
    parts = _axes(across, up, x_label, _with_power(y_label, power))
    for number, curve in enumerate(curves):
        colour = COLOURS[number % len(COLOURS)]
        points = [(across.place(x), up.place(y * factor)) for x, y in zip(curve.x, curve.y, strict=True)]
        if not by_row and len(points) > 1:
            path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
            parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.1"/>')
        if len(points) <= MAX_MARKED or by_row:
            parts += [f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2" fill="{colour}"/>' for x, y in points]
    parts += _legend([curve.label for curve in curves])
    return _svg(WIDTH, HEIGHT, parts)


def bars_chart(labels: Sequence[str], values: Sequence[float], label: str) -> str:
    """One bar below the other: parts of a whole, %."""
    row, left = 17.0, 250.0
    height = row * len(labels) + 30.0
    scale = _Scale(0.0, 100.0, left, WIDTH - 46.0, False)
    parts: list[str] = []
    for number, (name, value) in enumerate(zip(labels, values, strict=True)):
        y = 6.0 + row * number
        length = scale.place(value) - left
        parts.append(_text(left - 6, y + 10, _shortened(name, 52), "end"))
        parts.append(
            f'<rect x="{left}" y="{y + 2:.2f}" width="{length:.2f}" height="11" fill="{COLOURS[0]}"/>'
        )
        parts.append(_text(left + length + 4, y + 10, f"{value:.1f} %"))
    bottom = 6.0 + row * len(labels)
    parts.append(_line(left, 4, left, bottom, "#444444"))
    parts.append(_text((left + WIDTH - 46) / 2, bottom + 14, label, "middle"))
    return _svg(WIDTH, height, parts)


def correlation_chart(symbols: Sequence[str], matrix: Sequence[Sequence[float]]) -> str:
    """Correlation coefficients of the lower triangle as coloured fields with their numbers."""
    count = len(symbols)
    field, left, top = 32.0, 46.0, 8.0
    parts: list[str] = []
    for row in range(count):
        y = top + 18.0 * row
        parts.append(_symbol(left - 6, y + 12.5, symbols[row]))
        for column in range(row + 1):
            value = matrix[row][column]
            x = left + field * column
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{field}" height="18" fill="{_shade(value)}" '
                'stroke="#ffffff" stroke-width="1"/>'
            )
            colour = "#ffffff" if abs(value) > 0.6 else "#222222"
            words = "1" if row == column else f"{value + 0.0:.2f}".replace("-", "−")
            parts.append(_text(x + field / 2, y + 12.5, words, "middle", colour))
    y = top + 18.0 * count
    parts += [_symbol(left + field * (column + 0.5) + 8, y + 13, symbols[column]) for column in range(count)]
    return _svg(left + field * count + 10, y + 22, parts)


def _scale(values: Sequence[float], start: float, end: float, margin: float) -> _Scale:
    low, high = min(values), max(values)
    logarithmic = low > 0 and high / low > 100
    if logarithmic:
        low, high = math.log10(low), math.log10(high)
    spread = (high - low) or abs(high) or 1.0
    return _Scale(low - margin * spread, high + margin * spread, start, end, logarithmic)


def _common_power(values: Sequence[float]) -> int:
    """Power of ten that belongs to the axis's label; 0 where numbers are handy, or logarithmic."""
    largest = max(abs(value) for value in values)
    positive = min(values) > 0 and max(values) / min(values) > 100
    if largest == 0 or positive or 1e-2 <= largest < 1e4:
        return 0
    return math.floor(math.log10(largest))


def _with_power(label: str, power: int) -> str:
    return f"{label} × 10{str(power).translate(SUPERSCRIPTS)}" if power else label


def _round_step(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next(power * factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if power * factor >= step * 0.999)


def _axes(across: _Scale, up: _Scale, x_label: str, y_label: str) -> list[str]:
    parts: list[str] = []
    for value, label in across.ticks():
        x = across.place(value)
        parts.append(_line(x, TOP, x, HEIGHT - BOTTOM, "#dddddd"))
        parts.append(_text(x, HEIGHT - BOTTOM + 12, label, "middle"))
    for value, label in up.ticks():
        y = up.place(value)
        parts.append(_line(LEFT, y, WIDTH - RIGHT, y, "#dddddd"))
        parts.append(_text(LEFT - 5, y + 3, label, "end"))
    parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - RIGHT}" height="{HEIGHT - TOP - BOTTOM}" '
        'fill="none" stroke="#444444" stroke-width="0.8"/>'
    )
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, x_label, "middle"))
    parts.append(_text(LEFT, 12, y_label))
    return parts


def _legend(labels: Sequence[str]) -> list[str]:
    """At the upper right; one curve needs none."""
    if len(labels) < 2:
        return []
    parts: list[str] = []
    x = WIDTH - RIGHT
    for number in reversed(range(len(labels))):
        words = labels[number]
        x -= sum(9.0 if ord(letter) > 0x2E80 else 4.9 for letter in words) + 4.0
        parts.append(_text(x, 15, words))
        x -= 5.0
        parts.append(f'<circle cx="{x:.2f}" cy="12" r="2.4" fill="{COLOURS[number % len(COLOURS)]}"/>')
        x -= 12.0
    return parts


def _shade(value: float) -> str:
    """White at 0; blue to +1, orange to −1."""
    target = (31, 78, 121) if value >= 0 else (192, 90, 28)
    part = min(1.0, abs(value))
    return "#" + "".join(f"{round(255 + (colour - 255) * part):02x}" for colour in target)


def _shortened(words: str, most: int) -> str:
    return words if len(words) <= most else words[: most - 1] + "…"


def _line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    ends = f'x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="0.6"/>'


def _text(x: float, y: float, words: str, anchor: str = "start", colour: str = "#222222") -> str:
    return f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}" fill="{colour}">{escape(words)}</text>'


def _symbol(x: float, y: float, symbol: str) -> str:
    """m_xx with its index below the line, ended at x."""
    letter, _, index = symbol.partition("_")
    below = f'<tspan dy="2.5" font-size="7">{escape(index)}</tspan>' if index else ""
    return (
        f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="end" fill="#222222">'
        f'<tspan font-style="italic">{escape(letter)}</tspan>{below}</text>'
    )


def _svg(width: float, height: float, parts: Sequence[str]) -> str:
    """FONTS is replaced by the families that the document is set in."""
    inside = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" height="{height:.0f}" font-family="FONTS" font-size="9">\n{inside}\n</svg>\n'
    )
