"""The pages: a floor page and a page for each unit, refreshed part by part.

NiceGUI carries the parts to the browser; what they are is made by the markup modules from view
models. A part is sent only when it has changed. `sanitize=False`: the markup is our own and
escapes every text by construction (`dashboards/markup.py`).
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from urllib.parse import quote

from nicegui import ui
from starlette.requests import Request

from dashboards.floor_markup import (
    alarm_panel,
    fallen_panel,
    group_heading,
    key_figures,
    queue_panel,
    records_line,
    station_card,
    yield_panel,
)
from dashboards.frame_markup import (
    away_banner,
    connection_pill,
    header_bar,
    unknown_unit,
    waiting_for_line,
    waiting_for_unit,
)
from dashboards.markup import Html
from dashboards.read_model import ReadModel, Snapshot, UnitAnswer
from dashboards.unit_markup import attempt_card, unit_heading
from dashboards.unit_view import unit_view
from dashboards.view_models import FloorView, floor_view
from protocol.language import LANGUAGES

REFRESH_S = 0.5
UNIT_REFRESH_S = 1.5
THEMES: dict[str, bool | None] = {"auto": None, "light": False, "dark": True}
LANGUAGE_COOKIE = "testloom_language"
THEME_COOKIE = "testloom_theme"


@dataclass(frozen=True)
class Preferences:
    """What this browser chose."""

    language: str
    theme: str


def preferences(request: Request, default_language: str) -> Preferences:
    """From the browser's cookies; anything else than a known choice is the default."""
    language = request.cookies.get(LANGUAGE_COOKIE, default_language)
    theme = request.cookies.get(THEME_COOKIE, "auto")
    return Preferences(
        language if language in LANGUAGES else default_language, theme if theme in THEMES else "auto"
    )


def register_pages(model: ReadModel, line: str, default_language: str) -> None:
    """Define the pages `/` and `/unit/{serial}` over this model."""

    @ui.page("/")
    def floor(request: Request) -> None:
        chosen = preferences(request, default_language)
        page = _Frame(chosen, line, back="/")
        FloorPage(page, model)

    @ui.page("/unit/{serial:path}")
    async def unit(request: Request, serial: str) -> None:
        chosen = preferences(request, default_language)
        page = _Frame(chosen, line, back=f"/unit/{quote(serial, safe='')}", serial=serial)
        await UnitPage(page, model, serial).begin()


class _Frame:
    """What all pages share: style, theme, header, the banner when the coordinator is away."""

    def __init__(self, chosen: Preferences, line: str, back: str, serial: str = "") -> None:
        self.language = chosen.language
        ui.page_title(f"{serial or line} · Testloom")
        ui.add_head_html(f"<style>{_style()}</style>")
        ui.dark_mode(THEMES[chosen.theme])
        attributes = 'lang="zh-CN"' if chosen.language == "zh" else 'lang="en"'
        self.root = ui.element("div").classes("testloom").props(attributes)
        with self.root:
            with ui.element("div").classes("bar"):
                _part(header_bar(line, chosen.language, chosen.theme, back, is_floor=not serial))
                self._pill = _part()
            self._banner = _part()
            self.body = ui.element("main").classes("body")

    def show_connection(self, snapshot: Snapshot) -> None:
        """Banner and greyed data while the coordinator is away."""
        away = snapshot.connection.state == "away"
        _set(self._pill, connection_pill(snapshot.connection, self.language))
        _set(self._banner, away_banner(snapshot, self.language) if away else Html(""))
        if away:
            self.root.classes(add="stale")
        else:
            self.root.classes(remove="stale")


class FloorPage:
    """The floor: key figures, stations by what they do, and the side column."""

    def __init__(self, frame: _Frame, model: ReadModel) -> None:
        self._frame = frame
        self._model = model
        self._shape: object = None
        self._headings: list[ui.html] = []
        self._cards: dict[str, ui.html] = {}
        with frame.body:
            self._figures = _part().classes("wide")
            self._floor = ui.element("div").classes("floor")
            with ui.element("aside").classes("side"):
                self._side = [_part() for _ in _SIDE]
            self._records = _part().classes("wide")
        self.refresh()
        ui.timer(REFRESH_S, self.refresh)

    def refresh(self) -> None:
        """Show what is known now; only what changed is sent."""
        snapshot = self._model.snapshot()
        language = self._frame.language
        self._frame.show_connection(snapshot)
        if snapshot.status is None:
            _set(self._figures, waiting_for_line(snapshot.connection, language))
            return
        view = floor_view(snapshot.status, snapshot.live)
        _set(self._figures, key_figures(view, language))
        self._refresh_floor(view)
        for part, draw in zip(self._side, _SIDE, strict=True):
            _set(part, draw(view, language))
        _set(self._records, records_line(view, language))

    def _refresh_floor(self, view: FloorView) -> None:
        shape = tuple((group.operations, tuple(s.station for s in group.stations)) for group in view.groups)
        if shape != self._shape:
            self._build_floor(view)
            self._shape = shape
        for heading, group in zip(self._headings, view.groups, strict=True):
            _set(heading, group_heading(group, self._frame.language))
            for station in group.stations:
                _set(self._cards[station.station], station_card(station, self._frame.language))

    def _build_floor(self, view: FloorView) -> None:
        self._floor.clear()
        self._floor.classes(replace=f"floor density-{view.density}")
        self._headings, self._cards = [], {}
        with self._floor:
            for group in view.groups:
                with ui.element("section").classes("group"):
                    self._headings.append(_part().classes("group-heading"))
                    with ui.element("div").classes("stations"):
                        for station in group.stations:
                            self._cards[station.station] = _part().classes("card")


_SIDE: tuple[Callable[[FloorView, str], Html], ...] = (
    alarm_panel,
    lambda view, language: queue_panel(view.queues, language),
    lambda view, language: yield_panel(view.yields, language),
    fallen_panel,
)


class UnitPage:
    """A unit: where it is and every attempt. Asked again while the page is open."""

    def __init__(self, frame: _Frame, model: ReadModel, serial: str) -> None:
        self._frame = frame
        self._model = model
        self._serial = serial
        self._attempts: dict[str, ui.html] = {}
        with frame.body:
            self._heading = _part().classes("wide")
            self._list = ui.element("div").classes("attempts wide")

    async def begin(self) -> None:
        """Show the unit and keep it up to date."""
        await self.refresh()
        ui.timer(UNIT_REFRESH_S, self.refresh)

    async def refresh(self) -> None:
        """Ask for the unit (off the event loop: the query blocks) and show it."""
        answer = await asyncio.to_thread(self._model.unit, self._serial)
        self._frame.show_connection(self._model.snapshot())
        self._show(answer)

    def _show(self, answer: UnitAnswer) -> None:
        language = self._frame.language
        if answer.history is None:
            self._list.clear()
            self._attempts = {}
            words = (
                unknown_unit(self._serial, answer.unknown, language)
                if answer.unknown
                else waiting_for_unit(self._serial, language)
            )
            _set(self._heading, words)
            return
        view = unit_view(answer.history)
        _set(self._heading, unit_heading(view, language))
        if list(self._attempts) != [attempt.attempt_id for attempt in view.attempts]:
            self._list.clear()
            with self._list:
                self._attempts = {attempt.attempt_id: _part() for attempt in view.attempts}
        for attempt in view.attempts:
            _set(self._attempts[attempt.attempt_id], attempt_card(attempt, language))


def _part(content: str = "") -> ui.html:
    return ui.html(content, sanitize=False)


def _set(part: ui.html, content: Html) -> None:
    if part.content != content:
        part.set_content(content)


@cache
def _style() -> str:
    return resources.files("dashboards").joinpath("style.css").read_text(encoding="utf-8")
