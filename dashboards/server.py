"""The dashboard's process: one web server, one read model, nothing that leaves the machine."""

import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from urllib.parse import quote

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import RedirectResponse
from nicegui import ui

from dashboards.line_source import ConnectLine, zenoh_line
from dashboards.pages import LANGUAGE_COOKIE, THEME_COOKIE, THEMES, register_pages
from dashboards.read_model import ReadModel
from protocol.adapters.structured_log import log_as_json
from protocol.addresses import DASHBOARD_PORT, LOOPBACK
from protocol.errors import Fault, TestloomError
from protocol.keys import checked_name
from protocol.language import LANGUAGES, chosen_language

SHUTDOWN_TIMEOUT_S = 1
COOKIE_AGE_S = 365 * 24 * 3600
MAX_SERIAL_LENGTH = 64

# The browser itself refuses what would leave the machine, whoever asks for it. Vue compiles its
# templates in the page, hence unsafe-eval; NiceGUI writes its state into inline scripts.
_CONTENT_SECURITY_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; "
    "form-action 'self'"
)
_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24" fill="none" stroke="#2f6fde" '
    'stroke-width="2.4" stroke-linecap="round">'
    '<path d="M4 7h16M4 12h16M4 17h16M8 4v16M12 4v16M16 4v16"/></svg>'
)


def run_dashboard(
    line: str,
    router_endpoint: str,
    host: str = LOOPBACK,
    port: int = DASHBOARD_PORT,
    language: str | None = None,
    *,
    on_listening: Callable[[str], None] = lambda _url: None,
    connect: ConnectLine | None = None,
) -> None:
    """Serve the dashboard until SIGTERM or SIGINT.

    Args:
        line: name of the line.
        router_endpoint: Zenoh locator of the router, such as tcp/127.0.0.1:7447. It need not be
            there yet: the page comes up, says so, and recovers by itself.
        host: address to listen at. Whoever can reach it can read everything: there is no login.
        port: 0 takes a free one.
        language: default of the pages, 'en' or 'zh'; None: TESTLOOM_LANG. A browser may choose.
        on_listening: called with the URL once it answers.
        connect: where the data come from, instead of the coordinator behind the router.

    Raises:
        TestloomError: the port is in use, or the address is not this machine's.
    """
    checked_name(line, "line")
    language = language if language in LANGUAGES else chosen_language()
    listening = _listen(host, port)
    shown_host = f"[{host}]" if ":" in host else host
    url = f"http://{shown_host}:{listening.getsockname()[1]}/"
    log_as_json(line=line, process="dashboard")
    model = ReadModel(connect or zenoh_line(line, router_endpoint))
    register_pages(model, line, language)
    application = _application(language)
    configuration = uvicorn.Config(
        application, log_level="warning", access_log=False, timeout_graceful_shutdown=SHUTDOWN_TIMEOUT_S
    )
    model.start()
    try:
        _Server(configuration, lambda: on_listening(url)).run(sockets=[listening])
    finally:
        model.stop()
        listening.close()


class _Server(uvicorn.Server):
    """Says when it listens, and ends by returning: uvicorn would raise the signal again."""

    def __init__(self, configuration: uvicorn.Config, on_started: Callable[[], None]) -> None:
        super().__init__(configuration)
        self._on_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._on_started()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {name: signal.signal(name, self.handle_exit) for name in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for name, handler in before.items():
                signal.signal(name, handler)


def _application(language: str) -> FastAPI:
    application = FastAPI(title="Testloom", openapi_url=None, docs_url=None, redoc_url=None)

    @application.middleware("http")
    async def stay_on_this_machine(request: Request, call_next) -> Response:
        response: Response = await call_next(request)
        response.headers["Content-Security-Policy"] = _CONTENT_SECURITY_POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    @application.get("/language/{chosen}")
    def choose_language(chosen: str, back: str = "/") -> Response:
        return _remember(LANGUAGE_COOKIE, chosen if chosen in LANGUAGES else language, back)

    @application.get("/theme/{chosen}")
    def choose_theme(chosen: str, back: str = "/") -> Response:
        return _remember(THEME_COOKIE, chosen if chosen in THEMES else "auto", back)

    @application.get("/unit")
    def find_unit(serial: str = "") -> Response:
        wanted = serial.strip()[:MAX_SERIAL_LENGTH]
        return RedirectResponse(f"/unit/{quote(wanted, safe='')}" if wanted else "/", status_code=303)

    ui.run_with(
        application,
        title="Testloom",
        favicon=_FAVICON,
        dark=None,
        tailwind=False,
        binding_refresh_interval=None,
        show_welcome_message=False,
    )
    return application


def _remember(cookie: str, value: str, back: str) -> Response:
    """Set a preference and return to the page; `back` may only be a path of this server."""
    own_path = back.startswith("/") and not back.startswith(("//", "/\\"))
    response = RedirectResponse(quote(back, safe="/%") if own_path else "/", status_code=303)
    response.set_cookie(cookie, value, max_age=COOKIE_AGE_S, samesite="strict", httponly=True)
    return response


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    # A port in TIME_WAIT from our last run may be taken again; one that is listened at may not.
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen(128)
    except OSError as error:
        listening.close()
        raise TestloomError(
            f"The dashboard cannot listen at {host}:{port}: {error.strerror or error}.",
            where=f"{host}:{port}",
            fault=Fault.OPERATOR,
            remedy="stop what uses the port, or choose another address with --host and --port.",
        ) from None
    return listening
