"""The dashboard as a process: starts without a coordinator, refuses a taken port, ends on SIGTERM."""

import json
import socket
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from served_line import start_served_line, stop_served_line

from dashboards.server import run_dashboard
from protocol.errors import TestloomError

pytestmark = pytest.mark.fabric

FOREIGN_PLACES = ("https://elsewhere.example/", "//elsewhere.example/", "/%5Celsewhere.example", "%0d%0aX:y")


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def http_error_303(self, req, fp, code, msg, headers):
        return fp


def test_it_comes_up_without_a_coordinator_and_ends_cleanly(tmp_path: Path) -> None:
    line = start_served_line(tmp_path)
    try:
        with urllib.request.urlopen(line.url, timeout=10) as answer:
            page = answer.read().decode()
            policy = answer.headers["Content-Security-Policy"]
        ways_back = [_way_back(line.url, place) for place in FOREIGN_PLACES]
    finally:
        code, error = stop_served_line(line)
    assert "Asking the coordinator" in page or "Waiting for the coordinator" in page
    assert "default-src 'self'" in policy
    assert {urlsplit(way).netloc for way in ways_back} == {""}, "a link cannot lead through us to elsewhere"
    assert not any(way.startswith(("//", "/\\")) for way in ways_back)
    assert code == 0
    log = [json.loads(entry) for entry in error.splitlines()]
    assert [(entry["level"], entry["event"]) for entry in log] == [("warning", "coordinator does not answer")]
    assert list(tmp_path.iterdir()) == [], "it leaves no file behind"


def _way_back(url: str, place: str) -> str:
    request = urllib.request.Request(f"{url}language/zh?back={place}")
    with urllib.request.build_opener(_NoRedirect()).open(request, timeout=10) as answer:
        assert answer.status == 303
        return answer.headers["Location"]


def test_a_port_in_use_is_said_with_what_to_do() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(TestloomError, match=f"cannot listen at 127.0.0.1:{port}") as refused:
            run_dashboard("demo", "tcp/127.0.0.1:1", port=port)
    assert "--port" in refused.value.remedy
