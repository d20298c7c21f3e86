"""A picture of a page: `python tests/dashboards/take_screenshot.py URL FILE [WIDTH HEIGHT [light|dark]]`."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import BrowserContext, sync_playwright

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def open_browser(**options: Any) -> Iterator[BrowserContext]:
    """Debian's Chromium, headless, with a fresh profile; ends with the block."""
    with tempfile.TemporaryDirectory(prefix="testloom-browser-") as profile, sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            profile, executable_path=CHROMIUM, headless=True, args=list(ARGUMENTS), **options
        )
        try:
            yield context
        finally:
            context.close()


def take(url: str, file: str, width: int = 1920, height: int = 1080, theme: str = "light") -> None:
    """The page at `url` as it looks after it has settled."""
    size = {"width": width, "height": height}
    with open_browser(viewport=size, color_scheme=theme, device_scale_factor=1) as browser:
        page = browser.new_page()
        page.goto(url)
        page.locator(".socket, .attempt, .empty").first.wait_for(timeout=15_000)
        page.wait_for_timeout(1500)
        page.screenshot(path=file)


if __name__ == "__main__":
    place = sys.argv[3:5]
    width, height = (int(place[0]), int(place[1])) if len(place) == 2 else (1920, 1080)
    take(sys.argv[1], sys.argv[2], width, height, sys.argv[5] if len(sys.argv) > 5 else "light")
