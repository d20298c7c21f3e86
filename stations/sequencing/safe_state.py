"""The safe state: no stream, no power, open relays, a stand at rest, an empty socket.

It is sought after every sequence, whatever its teardown did, each part for itself: one that fails
keeps no other from being tried. It counts as reached only by what the instruments say afterwards.
"""

from collections.abc import Callable
from dataclasses import dataclass

from protocol.errors import TestloomError
from stations.drivers.clock import BranchClock
from stations.drivers.socket_bench import SocketBench

DISCHARGED_V = 0.5
DISCHARGE_POLL_S = 0.01
MAX_DISCHARGE_POLLS = 100
MAX_DURATION_BENCH_S = 60.0
"""A stand comes to rest and a rail discharges well within this."""


@dataclass(frozen=True)
class SafeState:
    """Whether it was reached, and what stood against it."""

    reached: bool
    problems: tuple[str, ...]


def make_safe(bench: SocketBench, clock: BranchClock) -> SafeState:
    """Bring a socket into the safe state, as far as the bench still works. Never raises."""
    clock.interruption = lambda: None
    clock.limit(clock.now_s() + MAX_DURATION_BENCH_S)
    # a stream that cannot be stopped ends with the power: no matter for the safe state
    _problem("stream", lambda: _stop_stream(bench, clock))
    parts: dict[str, Callable[[], None]] = {
        "power": lambda: _power_off(bench, clock),
        "relays": lambda: _open_relays(bench, clock),
        "stand": lambda: bench.stop_stand(clock),
        "socket": lambda: _empty_socket(bench, clock),
    }
    found = [_problem(name, action) for name, action in parts.items()]
    clock.limit(None)
    problems = tuple(problem for problem in found if problem)
    return SafeState(not problems, problems)


def _problem(name: str, action: Callable[[], None]) -> str:
    try:
        action()
    except TestloomError as error:
        return f"{name}: {error.what}"
    except Exception as error:  # noqa: BLE001 - no part may keep another from being tried
        return f"{name}: {type(error).__name__}: {error}"
    return ""


def _stop_stream(bench: SocketBench, clock: BranchClock) -> None:
    if bench.unit_link_is_open and bench.supply(clock).set_voltage_v is not None:
        bench.unit_link(clock).stop_stream()


def _power_off(bench: SocketBench, clock: BranchClock) -> None:
    supply = bench.supply(clock)
    supply.switch(False)
    if supply.is_on():
        raise TestloomError("the supply says that its output is still on")
    for _ in range(MAX_DISCHARGE_POLLS):
        if abs(supply.measure_voltage_v()) <= DISCHARGED_V:
            return
        clock.sleep_until(clock.now_s() + DISCHARGE_POLL_S)
    raise TestloomError(f"the supply is off and its output is still above {DISCHARGED_V:g} V")


def _open_relays(bench: SocketBench, clock: BranchClock) -> None:
    board = bench.board(clock)
    if board is not None:
        board.open_all()


def _empty_socket(bench: SocketBench, clock: BranchClock) -> None:
    handler = bench.handler(clock)
    if handler.holds_unit:
        handler.remove()
