"""Chromium and a served imagined line for the tests of the dashboard."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext

sys.path.insert(0, str(Path(__file__).parent))  # the imagined line and the browser live beside the tests

from imagined_line import failed_then_passed, small_line
from served_line import ServedLine, start_served_line, stop_served_line
from take_screenshot import CHROMIUM, open_browser


@pytest.fixture(scope="module")
def served_line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLine]:
    """One process for a module of tests."""
    line = start_served_line(tmp_path_factory.mktemp("imagined-line"))
    try:
        yield line
    finally:
        stop_served_line(line)


@pytest.fixture
def imagined(served_line: ServedLine) -> ServedLine:
    """The served line, showing the small imagined line in mid-run."""
    served_line.show(*small_line())
    served_line.show_unit(failed_then_passed())
    return served_line


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserContext]:
    """Headless Chromium; a skip is loud, and a failure where everything is required."""
    if not Path(CHROMIUM).is_file():
        words = f"{CHROMIUM} is missing (apt-get install chromium): the dashboard was not tested in a browser"
        if os.environ.get("TESTLOOM_REQUIRE_ALL") == "1":
            pytest.fail(words)
        pytest.skip(words)
    with open_browser(viewport={"width": 1600, "height": 1000}) as context:
        context.set_default_timeout(15_000)
        yield context
