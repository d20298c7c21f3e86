"""Watching a line at work: orders units, shows progress, keeps its processes up."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from cli.line_client import LineClient, line_client
from cli.line_display import live_view, progress_line, starting_view, summary_lines, units_table, yield_table
from cli.line_layout import LineLayout
from cli.line_summary import Truth
from cli.process_group import ProcessGroup
from protocol.adapters.zenoh_link import NoReplyError, RequestRejectedError
from protocol.addresses import DEFAULT_ROUTER
from protocol.attempts import UnitIdentity
from protocol.errors import Fault, TestloomError
from protocol.language import say
from protocol.line_views import GetLineStatus, LineStatus, OrderAccepted, OrderUnits
from protocol.routes import GNC_MODULE_ROUTE

POLL_S = 0.3
LOG_PERIOD_S = 3.0
MAX_STORY = 100
STATUS_PATIENCE_S = 0.0
STAY_PATIENCE_S = 3600.0


class LineWatch:
    """The eyes of `testloom up`. Every wait tends the processes and is bounded."""

    def __init__(self, layout: LineLayout, group: ProcessGroup, *, quiet: bool) -> None:
        self._layout = layout
        self._group = group
        self._console = Console(quiet=quiet, highlight=False)
        self._story: list[str] = []
        self._started_s = time.monotonic()
        self._last_logged_s = 0.0
        self._restarts: dict[str, int] = {}
        self._told = ""
        self._placed: OrderUnits | None = None
        self._starting: Live | None = None

    def announce(self) -> None:
        """Say where everything is, and how to ask this line."""
        self._say(say("Everything of this run is in {directory}", directory=self._layout.directory))
        if self._layout.dashboard_port is not None:
            address = f"http://127.0.0.1:{self._layout.dashboard_port}"
            self._say(say("The line's page: {address}", address=address))
        if self._layout.router_endpoint != DEFAULT_ROUTER:
            option = f"--router {self._layout.router_endpoint}"
            self._say(say("Another line has the usual port; ask this one with {option}", option=option))

    def order(self, units: int, timeout_s: float) -> OrderUnits:
        """Put a lot on the line as soon as the coordinator answers.

        Raises:
            TestloomError: the line did not come up in time, or its database holds another run.
        """
        lot = _lot_name(self._layout.seed)
        route = GNC_MODULE_ROUTE
        identities = tuple(
            UnitIdentity(serial=f"GM-{lot}-{number:04d}", product=route.product, lot=lot)
            for number in range(1, units + 1)
        )
        order = self._placed = OrderUnits(order_id=f"order-{lot}", route=route, units=identities)
        with self._live() as live:
            self._starting = live
            with self._client(timeout_s) as client:
                self._ask_until_answered(lambda: self._require_new_line(client), timeout_s)
                self._ask_until_answered(lambda: client.ask(order, OrderAccepted, 0.0), timeout_s)
            self._starting = None
        return order

    def until_finished(self, timeout_s: float) -> LineStatus:
        """Watch until every unit has its disposition.

        Raises:
            TestloomError: the line made no end in time, or a process died too often.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._client(timeout_s) as client, self._live() as live:
            while time.monotonic() < deadline_s:
                status = self._status(client)
                if status is not None:
                    self._show(status, live)
                    if self._placed is not None and len(status.units) < len(self._placed.units):
                        self._order_again(client, self._placed)
                    if status.finished:
                        return status
                self._tend()
                time.sleep(POLL_S)
        raise self._came_to_no_end(timeout_s)

    def until_spools_are_empty(self, timeout_s: float) -> None:
        """Give the stations the time to have their last records acknowledged."""
        from stations.spool import unacknowledged_count

        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            if not any(unacknowledged_count(self._layout.spool(name)) for name in self._layout.stations()):
                return
            self._tend()
            time.sleep(POLL_S)

    def until_interrupted(self, status: LineStatus) -> LineStatus:
        """Keep the line up for people to look at and to order more. Ctrl-C ends it, and that is no error.

        Returns the last that was seen of the line, whose units are then more than those of the first order.
        """
        self._say(say("All units are done. The line stays up; end it with Ctrl-C."))
        try:
            with self._client(STAY_PATIENCE_S) as client, self._live() as live:
                while True:
                    status = self._status(client) or status
                    if live is not None:
                        self._show(status, live)
                    self._tend()
                    time.sleep(POLL_S)
        except KeyboardInterrupt:
            return status

    def show_result(
        self, status: LineStatus, summary: Mapping[str, Any], truths: Mapping[str, Truth]
    ) -> None:
        """The final tables."""
        self._console.print(units_table(status.units, truths))
        self._console.print(yield_table(status.yield_report))
        for line in summary_lines(summary):
            self._say(line)
        for name, count in self._restarts.items():
            self._say(say("{name} was started again {count} times", name=name, count=count))
        self._say(
            say(
                "{wall:.1f} s from the start of the line. Records: {database}; raw data: {recordings}",
                wall=summary["wall_s"],
                database=self._layout.database_url,
                recordings=self._layout.recordings,
            )
        )

    def _say(self, words: str | Text) -> None:
        """A sentence on one line, however wide the terminal: paths are to be copied, lines to be searched."""
        self._console.print(words, soft_wrap=True, markup=False)

    @contextmanager
    def _live(self) -> Iterator[Live | None]:
        """The line as a picture that stays in its place; None where nobody looks at a terminal."""
        if not self._console.is_terminal or self._console.quiet:
            yield None
            return
        with Live(console=self._console, refresh_per_second=4, transient=True) as live:
            yield live

    @contextmanager
    def _client(self, timeout_s: float) -> Iterator[LineClient]:
        def tended() -> bool:  # the router may be the one that has died
            self._tend()
            return True

        with line_client(self._layout.line, self._layout.router_endpoint, timeout_s, tended) as client:
            yield client

    def _ask_until_answered(self, ask: Callable[[], object], timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                ask()
                return
            except NoReplyError:
                if time.monotonic() >= deadline_s:
                    raise self._came_to_no_end(timeout_s) from None
            except RequestRejectedError as refusal:  # a full disk or a locked database may pass
                if time.monotonic() >= deadline_s:
                    raise
                self._tell(refusal)
            self._tend()
            time.sleep(POLL_S)

    def _order_again(self, client: LineClient, order: OrderUnits) -> None:
        """A coordinator whose database is new or restored has no order to work on; one that has it
        changes nothing. What was recorded before and is gone counts as lost, at the end."""
        try:
            client.ask(order, OrderAccepted, 0.0)
        except (NoReplyError, RequestRejectedError):
            return  # the next look at the status asks again

    def _require_new_line(self, client: LineClient) -> None:
        """A run counts its records against its own spools: those of another would look like duplicates."""
        if client.ask(GetLineStatus(), LineStatus, 0.0).units:
            raise TestloomError(
                "The database holds the units of another run.",
                where="--database",
                fault=Fault.OPERATOR,
                remedy="choose a new one with --database, or leave it out.",
            )

    def _status(self, client: LineClient) -> LineStatus | None:
        try:
            status = client.ask(GetLineStatus(), LineStatus, STATUS_PATIENCE_S)
        except NoReplyError:
            return None  # the router or the coordinator is being started again
        except RequestRejectedError as refusal:  # it goes on by itself when its disk is well again
            self._tell(refusal)
            return None
        self._told = ""
        return status

    def _tell(self, refusal: RequestRejectedError) -> None:
        """Say once why the coordinator does not answer now."""
        words = f"{refusal.what} {refusal.remedy}".strip()
        if words != self._told:
            self._told = words
            self._story = [*self._story, words][-MAX_STORY:]
            if not self._console.is_terminal:
                self._say(words)

    def _show(self, status: LineStatus, live: Live | None) -> None:
        elapsed_s = time.monotonic() - self._started_s
        if live is not None:
            live.update(live_view(status, elapsed_s, self._story, tuple(self._layout.stations())))
        elif elapsed_s - self._last_logged_s >= LOG_PERIOD_S or status.finished:
            self._last_logged_s = elapsed_s
            self._say(progress_line(status, elapsed_s))

    def _tend(self) -> None:
        news = self._group.tend()
        self._story = (self._story + news)[-MAX_STORY:]
        self._restarts = self._group.restarts()
        if not self._console.is_terminal:
            for line in news:
                self._say(line)
        if self._starting is not None:
            elapsed_s = time.monotonic() - self._started_s
            self._starting.update(starting_view(self._layout.line, elapsed_s, self._story))
        given_up = self._group.given_up()
        if given_up:
            raise TestloomError(
                f"These processes died too often: {', '.join(given_up)}.",
                where=str(self._layout.directory / "logs"),
                fault=Fault.TESTLOOM,
                remedy="read the end of their logs.",
                story=tuple(self._story[-5:]),
            )

    def _came_to_no_end(self, timeout_s: float) -> TestloomError:
        return TestloomError(
            f"The line did not get there within {timeout_s:.0f} s.",
            where=str(self._layout.directory / "logs"),
            fault=Fault.TESTLOOM,
            remedy="read the logs; `testloom doctor` checks the machine.",
            story=tuple(self._story[-5:]),
        )


def _lot_name(seed: int) -> str:
    """A lot's name, from which nobody can tell the seed: whoever has the seed knows the truth."""
    return hashlib.sha256(f"lot {seed}".encode()).hexdigest()[:4].upper()
