"""report.html: complete in both languages, without a network, the same bytes each time."""

import dataclasses
import itertools
import re
from html.parser import HTMLParser

import pytest

from dut_emulator.effects.catalogue import CATALOGUE
from gap_diagnosis import report_page, report_pictures, report_words
from gap_diagnosis.field_units import field_quantity, spelled_like
from gap_diagnosis.report_document import parse_report, report_text
from gap_diagnosis.report_style import heat_colour
from protocol.language import choose_language, say
from tests.gap_diagnosis.imagined_reports import document, parsed, report

VERDICTS = ("no_gap", "attributed", "confusable", "unattributed")
VOID = {"meta", "br", "link", "img"}


@pytest.fixture(autouse=True)
def _english_again():
    yield
    choose_language("en")


def report_html(imagined, of_form):
    return report_page.report_html(imagined, of_form, report_pictures.pictures(imagined))


class Outline(HTMLParser):
    """Open elements, headings, and whatever would be fetched."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.fetched += [
            str(value)
            for name, value in attrs
            if name in ("src", "href", "xlink:href") and not str(value).startswith("#")
        ]

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def outlined(text: str) -> Outline:
    outline = Outline()
    outline.feed(text)
    assert outline.open == []
    return outline


def small(verdict: str, pictures: int = 0):
    """With few pictures: they take most of the time."""
    whole = report(verdict)
    drawn = {"series": whole.series[:pictures], "spectra": whole.spectra[:pictures]}
    return dataclasses.replace(whole, **drawn)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_makes_a_whole_page_in_both_languages(verdict):
    headings: dict[str, int] = {}
    for language in ("en", "zh"):
        choose_language(language)
        text = report_html(small(verdict), parsed(verdict))
        outline = outlined(text)
        assert outline.fetched == []
        assert "http" not in text
        assert "@import" not in text
        headings[language] = text.count("<h2>")
        said = "".join(outline.words)
        assert report_words.verdict_words(parsed(verdict)) in said
        if language == "zh":
            left = re.findall(r">([A-Z][a-z]+ [a-z]+ [a-z ]+)<", text)
            assert [words for words in left if "saturated" not in words and "12.4 Hz" not in words] == []
    assert headings["en"] == headings["zh"] >= 4


def test_the_page_says_what_a_test_engineer_asks():
    text = "".join(outlined(report_html(small("attributed"), parsed("attributed"))).words)
    for wanted in (
        "one cause explains it: gyro: g-sensitivity (on gyro x)",
        "acc_xy = 0.00402 ± 0.00031 °/s per g",
        "99.6 % (95 %: 99.1 % to 99.8 %)",
        "specific force 0.5 … 1 g",
        "2e-05 (fitted tail)",
        "0.0142",
        "tumble, 2.1 min: 0.83 bits",
        "spin_deg_s = 100",
        "mems_ahrs-U-0007-swing-m1-r2",
        "40 samples of gyro_y were saturated.",
        "Held out from the fit, to judge it: run 2.",
    ):
        assert wanted in text, wanted
    either = "".join(outlined(report_html(small("confusable"), parsed("confusable"))).words)
    assert "cannot tell which: gyro: g-sensitivity or gyro: even non-linearity." in either


def test_a_report_that_knows_little_makes_a_page_and_markup_in_names_is_text():
    bare = {"format": "testloom-gap-report/1", "verdict": "unattributed"}
    bare["unattributed"] = {"p": None, "description": "<script>alert(1)</script>"}
    text = report_html(type(report("no_gap"))(bare), parse_report(report_text(bare)))
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    outlined(text)
    named = document("attributed")
    named["recordings"][0]["recording_id"] = "a<b>&c"
    assert "a&lt;b&gt;&amp;c" in report_html(small("attributed"), parse_report(report_text(named)))


def test_the_same_report_gives_the_same_bytes():
    drawn = small("attributed", pictures=1)
    once, again = (report_html(drawn, parsed("attributed")) for _ in range(2))
    assert once == again
    outline = outlined(once)
    assert outline.fetched == []
    assert "http" not in once.replace("http://www.w3.org/", "")  # names of vocabularies, never fetched
    assert not re.search(r"20\d\d-\d\d-\d\dT", once)
    files = [one.file_name for one in report_pictures.pictures(drawn)]
    assert sorted(files) == ["allan-gyro_x.svg", "residual-mems_ahrs-U-0007-swing-m1-r1-gyro_x.svg"]
    ids = re.findall(r'\bid="([^"]+)"', once)
    assert len(ids) == len(set(ids))


def test_every_effect_of_the_catalogue_has_a_name_in_both_languages():
    choose_language("zh")
    for name in CATALOGUE:
        words = report_words.effect_words(name)
        assert words != name
        assert not re.search(r"[a-z]{4}", words.replace("Allan", "")), words
    tables = (report_words.KINDS, report_words.VARIABLES, report_words.ORIGINS)
    for words in itertools.chain(*(table.values() for table in tables)):
        assert say(words) != words
    choose_language("en")
    assert len({report_words.effect_words(name) for name in CATALOGUE}) == len(CATALOGUE)


def test_a_curve_keeps_its_extremes_when_it_is_thinned():
    whole = report("attributed").series[0]
    time, drawn = report_pictures._envelope(whole.time_s, whole.before)
    assert len(drawn) == 2 * report_pictures.BINS
    assert (drawn.min(), drawn.max()) == (whole.before.min(), whole.before.max())
    assert (time[1:] >= time[:-1]).all()


@pytest.mark.parametrize(
    ("value", "unit", "uncertainty", "shown"),
    [
        (7.1e-6, "rad/s per m/s^2", 5.3e-7, "0.00399 ± 0.00030 °/s per g"),
        (2.42e-5, "rad", 2.4e-6, "4.99 ± 0.50 ″"),
        (5e-3, "s", 1e-4, "5.00 ± 0.10 ms"),
        (3e-4, "1", None, "300 ppm"),
        (0.004, "deg/s/g", 3e-4, "0.00400 ± 0.00030 °/s/g"),
        (3.1, "furlong", 0.2, "3.10 ± 0.20 furlong"),
    ],
)
def test_quantities_are_said_in_the_fields_units(value, unit, uncertainty, shown):
    assert field_quantity(value, unit, uncertainty) == shown


def test_a_unit_of_the_floor_is_spelled_as_the_catalogue_does():
    assert spelled_like("deg/s/g", "rad/s per m/s^2") == "deg/s per g"
    assert spelled_like("deg/s/g/g", "rad/s per m/s^2 per m/s^2") == "deg/s per g per g"
    assert spelled_like("deg/h", "rad/s") == "deg/h"
    assert spelled_like("deg/s", "rad/s per m/s^2") == "deg/s"  # to be refused as it was written


def test_the_map_goes_from_white_to_dark_and_stays_readable():
    grounds = [int(heat_colour(sigmas)[0][3:5], 16) for sigmas in (0.0, 2.0, 4.0, 6.0, 9.0)]
    assert grounds == sorted(grounds, reverse=True)
    assert (heat_colour(0.0)[1], heat_colour(-9.0)[1]) == ("#1a1a1a", "#fff")
