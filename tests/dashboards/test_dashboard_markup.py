"""Markup escapes by construction; words are there in both languages."""

import ast
import json
from html.parser import HTMLParser
from pathlib import Path
from string import Formatter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from imagined_line import failed_then_passed, small_line

import dashboards
from dashboards.floor_markup import alarm_panel, key_figures, queue_panel, station_card
from dashboards.frame_markup import header_bar, unknown_unit
from dashboards.icons import ICON_NAMES
from dashboards.markup import element
from dashboards.socket_states import LiveSocket
from dashboards.unit_markup import attempt_card
from dashboards.unit_view import unit_view
from dashboards.view_models import FloorView, Sentence, floor_view
from dashboards.words import SOCKET_STATE_WORDS, duration, operation_word, percent, sentence_words
from protocol.line_views import Alarm
from protocol.station_messages import SocketProgress

HOSTILE = "<img src=x onerror=alert(1)>\"'&{0}</div><script>"


class _Elements(HTMLParser):
    """Names of all elements, and the text between them."""

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.names.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def _parsed(html: str) -> _Elements:
    parser = _Elements()
    parser.feed(html)
    parser.close()
    return parser


@given(st.text(), st.text())
def test_any_text_comes_back_as_text(text: str, attribute: str) -> None:
    parsed = _parsed(element("p", text, title=attribute))
    assert parsed.names == ["p"]
    assert parsed.text == text.replace("\r\n", "\n") or parsed.text == text


def _hostile_floor() -> FloorView:
    status, _ = small_line()
    progress = SocketProgress(
        station="socket-board-1", socket="a", serial=HOSTILE, operation=HOSTILE, step=HOSTILE, steps_total=3
    )
    alarm = Alarm(raised_at_s=0.0, alarm=HOSTILE, subject=HOSTILE, text=HOSTILE)
    free = status.stations[0].sockets[0].model_copy(update={"serial": None, "operation": None})
    station = status.stations[0].model_copy(update={"station": HOSTILE, "sockets": (free,)})
    waiting = [u.model_copy(update={"waits_for": HOSTILE}) for u in status.units]
    hostile = status.model_copy(update={"stations": (station,), "alarms": (alarm,), "units": tuple(waiting)})
    return floor_view(hostile, {(HOSTILE, "a"): LiveSocket(progress, 1.0)})


def test_hostile_words_never_become_elements() -> None:
    view = _hostile_floor()
    parts = [
        station_card(view.groups[0].stations[0], "en"),
        alarm_panel(view, "en"),
        queue_panel(view.queues, "zh"),
        key_figures(view, "en"),
        header_bar(HOSTILE, "en", "auto", HOSTILE, is_floor=False),
        unknown_unit(HOSTILE, HOSTILE, "en"),
    ]
    history = failed_then_passed()
    record = history.attempts[0].record
    step = record.steps[0].model_copy(update={"message": HOSTILE, "step": HOSTILE})
    hostile = history.attempts[0].model_copy(
        update={"record": record.model_copy(update={"message": HOSTILE, "steps": (step,)})}
    )
    view_of_unit = unit_view(history.model_copy(update={"attempts": (hostile,)}))
    parts.append(attempt_card(view_of_unit.attempts[0], "en"))
    shown = [_parsed(part) for part in parts]
    assert not {"img", "script"} & {name for parsed in shown for name in parsed.names}
    assert all(HOSTILE in parsed.text for parsed in (shown[0], shown[1], shown[4], shown[5], shown[6]))


def test_each_socket_state_has_a_word_and_a_shape_of_its_own() -> None:
    assert set(SOCKET_STATE_WORDS) <= ICON_NAMES
    assert len(set(SOCKET_STATE_WORDS.values())) == len(SOCKET_STATE_WORDS)


def test_a_failed_socket_says_so_in_words_and_shape() -> None:
    status, progress = small_line()
    view = floor_view(status, {(p.station, p.socket): LiveSocket(p, 1.0) for p in progress})
    stations = view.groups[0].stations
    failed = [(s, k) for s in stations for k in s.sockets if k.state == "failed"]
    assert failed, "the imagined line has a red socket"
    card = station_card(failed[0][0], "zh")
    assert 'data-state="failed"' in card
    assert "不合格" in card
    assert failed[0][1].serial is not None
    assert failed[0][1].serial in card


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (59.4, "59 s"), (60, "1 min 0 s"), (3599.6, "1 h 00 min"), (7500, "2 h 05 min")],
)
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds, "en") == words


def test_a_yield_below_one_is_never_shown_as_100_percent() -> None:
    assert [percent(value) for value in (None, 0.0, 0.9996, 1.0)] == ["–", "0.0 %", "99.9 %", "100 %"]


def test_a_sentence_that_cannot_be_filled_in_stays_english() -> None:
    assert sentence_words(Sentence("in English", "{missing}", {"other": "x"}), "zh") == "in English"
    words = Sentence("waits for functional", "waits for {operation}", {"operation": "functional"})
    assert sentence_words(words, "zh") == "等待功能测试"
    assert sentence_words(Sentence("8 s", "{seconds} s", {"seconds": "8"}), "zh") == "8 秒"


def test_every_word_for_people_is_there_in_chinese() -> None:
    folder = Path(dashboards.__file__).parent
    chinese = json.loads((folder / "zh.json").read_text(encoding="utf-8"))
    spoken: set[object] = set()
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            spoken.update(word.value for word in _words_of(node) if isinstance(word, ast.Constant))
    assert spoken <= set(chinese)  # errors are there too, by the templates of their texts
    for english, translated in chinese.items():
        assert sorted(_fields(english)) == sorted(_fields(translated)), english


def _words_of(node: ast.AST) -> list[ast.expr | None]:
    """The first argument of a call of `say`, or the values of a table of words."""
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "say":
        return [node.args[0]]
    if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "").endswith("_WORDS"):
        return list(node.value.values) if isinstance(node.value, ast.Dict) else []
    return []


def _fields(template: str) -> list[str]:
    return [name for _, name, _, _ in Formatter().parse(template) if name]


def test_an_operation_not_known_here_goes_by_its_own_name() -> None:
    assert operation_word("swing_test", "zh") == "swing_test"
    assert operation_word("functional", "zh") == "功能测试"
