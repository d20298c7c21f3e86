"""The dashboard in headless Chromium, over a stand-in for the coordinator that the tests move."""

import re
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from imagined_line import small_line
from playwright.sync_api import BrowserContext, Page, expect
from served_line import ServedLine

from protocol.outcomes import Outcome

pytestmark = [pytest.mark.browser, pytest.mark.xdist_group("browser")]  # one browser, one imagined line

HOSTILE_PATH = "%3Cimg%20src%3Dx%20onerror%3D%22document.title%3D'taken'%22%3E"


@pytest.fixture
def page(browser: BrowserContext) -> Iterator[Page]:
    """A fresh page; whatever it asks for has to be on this machine, and nothing may go wrong in it."""
    browser.clear_cookies()
    asked: list[str] = []
    complaints: list[str] = []
    opened = browser.new_page()
    opened.on("request", lambda request: asked.append(request.url))
    opened.on("websocket", lambda socket: asked.append(socket.url))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    yield opened
    opened.close()
    hosts = {urlsplit(url).hostname for url in asked if urlsplit(url).scheme != "data"}
    assert hosts == {"127.0.0.1"}
    assert complaints == []


def test_floor_shows_sockets_units_queue_and_yield(imagined: ServedLine, page: Page) -> None:
    status, _ = small_line()
    page.goto(imagined.url)
    expect(page.locator(".station")).to_have_count(len(status.stations))
    expect(page.locator(".socket")).to_have_count(sum(len(s.sockets) for s in status.stations))
    on_station = [u.unit.serial for u in status.units if u.station == "turntable-1"]
    expect(page.locator('[data-station="turntable-1"] .serial')).to_have_text(on_station)
    expect(page.locator(".station.silent .badge")).to_contain_text("silent for 12 s")
    first_in_queue = page.locator(".queue li").first
    expect(first_in_queue).to_contain_text("1")
    expect(first_in_queue).to_contain_text("a free socket")
    row = status.yield_report.operations[0]
    expect(page.locator(".yield-line").first).to_contain_text(
        f"{row.first_passes} of {row.first_attempts} · 95 % interval"
    )
    expect(page.locator(".alarms li")).to_contain_text("socket-board-4")


def _background(page: Page, selector: str) -> str:
    """The colour that is shown; an element that is just being replaced has none, and is looked at again."""
    look = "selector => getComputedStyle(document.querySelector(selector)).backgroundColor"
    return page.wait_for_function(look, arg=selector).json_value()


def test_a_red_socket_is_seen_at_once(imagined: ServedLine, page: Page) -> None:
    status, progress = small_line()
    page.goto(imagined.url)
    socket = page.locator('.socket[data-station="turntable-2"]')
    expect(socket).to_have_attribute("data-state", "testing")
    failed = [
        view.model_copy(update={"outcome": Outcome.FAIL}) if view.station == "turntable-2" else view
        for view in progress
    ]
    imagined.show(status, failed)
    expect(socket).to_have_attribute("data-state", "failed")
    expect(socket.locator(".word")).to_have_text("Fail")
    red, green, blue = re.findall(r"\d+", _background(page, '.socket[data-station="turntable-2"]'))[:3]
    assert int(red) > 150 > 100 > max(int(green), int(blue)), "the whole tile is red"


def test_a_units_page_holds_measurements_against_limits(imagined: ServedLine, page: Page) -> None:
    page.goto(f"{imagined.url}unit/GNC-0003")
    expect(page.locator(".attempt")).to_have_count(4)
    expect(page.locator("h1")).to_contain_text("GNC-0003")
    rail = page.locator(".attempt").first.locator('[data-measurement="rail_3v3"]')
    for words in ("3.02 V", "3.135", "3.465", "-0.115", "Fail"):
        expect(rail).to_contain_text(words)
    expect(rail.locator(".mark.off-low")).to_be_visible()
    good = page.locator(".attempt").first.locator('[data-measurement="rail_5v"]')
    band, mark = good.locator(".allowed").bounding_box(), good.locator(".mark").bounding_box()
    assert band is not None
    assert mark is not None
    assert band["x"] < mark["x"] + mark["width"] / 2 < band["x"] + band["width"]
    expect(page.locator(".attempt.set-aside")).to_contain_text("lease of this attempt had been revoked")
    recording = page.locator(".recording")
    expect(recording).to_contain_text("recordings/GNC-0003/imu_calibration-12.mcap")
    expect(recording.locator(".hash")).to_have_text(re.compile(r"SHA-256 [0-9a-f]{64}"))


def test_the_coordinator_goes_away_and_comes_back(imagined: ServedLine, page: Page) -> None:
    page.goto(imagined.url)
    expect(page.locator(".pill.live")).to_be_visible()
    imagined.coordinator_leaves()
    banner = page.locator(".away-banner")
    expect(banner).to_contain_text("The coordinator has not answered for")
    expect(page.locator(".testloom.stale .socket").first).to_be_visible()
    imagined.show(*small_line())
    expect(banner).to_have_count(0)
    expect(page.locator(".testloom.stale")).to_have_count(0)
    expect(page.locator(".pill.live")).to_be_visible()


def test_language_and_theme_are_chosen_in_the_header_and_kept(imagined: ServedLine, page: Page) -> None:
    page.goto(f"{imagined.url}unit/GNC-0003")
    page.get_by_text("中文").click()
    expect(page.locator(".badge.failed").first).to_have_text("不合格")
    assert page.url == f"{imagined.url}unit/GNC-0003"
    page.goto(imagined.url)
    expect(page.locator(".pill")).to_have_text("实时")
    for theme in ("light", "dark"):
        page.locator(".switch.theme").click()
        expect(page.locator("body")).to_have_class(re.compile(f"body--{theme}"))
    page.get_by_text("English").click()
    expect(page.locator(".pill")).to_have_text("Live")


def test_an_unknown_serial_is_said_whatever_it_looks_like(imagined: ServedLine, page: Page) -> None:
    page.goto(f"{imagined.url}unit/{HOSTILE_PATH}")
    expect(page.locator(".unknown h1")).to_contain_text("<img src=x onerror=")
    expect(page.locator(".unknown")).to_contain_text("not known on the line")
    expect(page.locator(".unknown img")).to_have_count(0)
    assert page.title() != "taken"


def test_a_serial_typed_into_the_header_leads_to_its_unit(imagined: ServedLine, page: Page) -> None:
    page.goto(imagined.url)
    page.get_by_placeholder("Serial number").fill(" GNC-0003 ")
    page.get_by_placeholder("Serial number").press("Enter")
    expect(page.locator(".unit-heading h1")).to_contain_text("GNC-0003")


@pytest.mark.parametrize("width", [390, 1024, 1920])
def test_nothing_runs_off_the_side(imagined: ServedLine, page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    for path in ("", "unit/GNC-0003"):
        page.goto(f"{imagined.url}{path}")
        page.locator(".socket, .attempt").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
