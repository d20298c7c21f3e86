"""docs/effects.md and its pictures say what the catalogue holds."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dut_emulator.effects.catalogue import CATALOGUE, KINDS
from dut_emulator.effects.document import document
from dut_emulator.effects.line_plot import MAX_POINTS, Curve, Plot
from dut_emulator.effects.pictures import SHOTS, pictures
from dut_emulator.picture_style import COLOURS

DOCS = Path(__file__).resolve().parents[2] / "docs"
WRITE = "python -m dut_emulator.effects.document"
LARGEST_BYTES = 1_500_000
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
A_PIXEL = 1.0  # another processor may round the last digit of a coordinate otherwise


@pytest.fixture(scope="module")
def drawn() -> dict[str, str]:
    return pictures()


def test_the_document_is_that_of_the_catalogue() -> None:
    assert (DOCS / "effects.md").read_text(encoding="utf-8") == document(), WRITE


def test_every_effect_is_in_the_document_with_its_limits_of_validity() -> None:
    text = document()
    assert [name for name in CATALOGUE if f"`{name}`" not in text] == []
    assert [name for name, (kind, _) in CATALOGUE.items() if not kind.valid] == []


def test_every_effect_has_its_picture_and_the_document_shows_it(drawn: dict[str, str]) -> None:
    assert set(SHOTS) == {kind.word for kind in KINDS}
    assert {path.name for path in (DOCS / "effects").glob("*")} == set(drawn), WRITE
    text = document()
    assert [name for name in drawn if f"(effects/{name})" not in text] == []
    assert sum(len(svg.encode()) for svg in drawn.values()) < LARGEST_BYTES


def test_the_pictures_are_those_of_the_effects(drawn: dict[str, str]) -> None:
    for name, svg in drawn.items():
        kept = (DOCS / "effects" / name).read_text(encoding="utf-8")
        assert NUMBER.sub("#", kept) == NUMBER.sub("#", svg), f"{name}: {WRITE}"
        old, new = (np.array(NUMBER.findall(text), dtype=float) for text in (kept, svg))
        assert np.abs(old - new).max() <= A_PIXEL, f"{name}: {WRITE}"


def test_every_picture_has_a_line_and_units_on_both_axes(drawn: dict[str, str]) -> None:
    for name, svg in drawn.items():
        root = ElementTree.fromstring(svg)
        words = [item.text or "" for item in root.iter("{http://www.w3.org/2000/svg}text")]
        assert sum(", " in word for word in words) == 2, name
        assert "nan" not in svg, name


def test_a_plot_puts_values_where_its_ticks_say() -> None:
    svg = Plot("time, s", "way, m", (Curve("c", np.array([0.0, 10.0]), np.array([-1.0, 1.0])),)).svg()
    ((begin, end),) = re.findall(rf'd="M ([\d. ]+)\nL ([\d. ]+)\n"[^>]*stroke: {COLOURS[0]}', svg)[:1]
    text = r'text-anchor: (\w+)" x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]+)</text>'
    x = {word: float(at) for anchor, at, _, word in re.findall(text, svg) if anchor == "middle"}
    y = {word: float(at) for anchor, _, at, word in re.findall(text, svg) if anchor == "end"}
    half_a_digit = y["0.00"] - (float(begin.split()[1]) + float(end.split()[1])) / 2
    assert 0 < half_a_digit < 6  # a text lies on its base line
    assert [float(v) for v in begin.split()] == pytest.approx([x["0"], y["-1.00"] - half_a_digit], abs=0.11)
    assert [float(v) for v in end.split()] == pytest.approx([x["10"], y["1.00"] - half_a_digit], abs=0.11)


def test_a_gap_stays_a_gap_in_a_curve_that_is_thinned_out() -> None:
    values = np.ones(5 * MAX_POINTS + 1)
    values[len(values) // 2 + 1] = np.nan
    svg = Plot("x, 1", "y, 1", (Curve("c", np.arange(len(values), dtype=float), values),)).svg()
    (path,) = re.findall(rf'd="([^"]+)"[^>]*stroke: {COLOURS[0]}[^"]*"', svg)[:1]
    assert path.count("M") == 2
    assert path.count("L") < 1.1 * MAX_POINTS
