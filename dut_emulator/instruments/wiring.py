# pyright: strict
"""What instruments are wired to: a supply's loads, and what a board connects to the shared inputs."""

from typing import Protocol


class Load(Protocol):
    """What hangs on one channel of a supply: a socket, with or without a unit."""

    def set_supply(self, voltage_v: float, now_s: float) -> None: ...

    def supply_current_a(self, now_s: float) -> float: ...


class Probed(Protocol):
    """A socket's test points, true values; an empty socket is open everywhere."""

    def resistance_ohm(self, high: str, low: str) -> float: ...

    def voltage_v(self, high: str, low: str, now_s: float) -> float: ...

    def ripple_v(self, point: str, now_s: float) -> float: ...

    def period_s(self, point: str, now_s: float) -> float | None: ...

    def knows_point(self, point: str) -> bool: ...

    def present(self) -> bool: ...

    def set_ad_source(self, source: str, voltage_v: float) -> None: ...


class SharedInputs:
    """The pair of wires from the boards to the multimeter and the oscilloscope: one board at a time."""

    def __init__(self) -> None:
        self._board: str | None = None
        self._socket: Probed | None = None
        self._points = ("", "")
        self._settled_s = 0.0

    @property
    def label(self) -> str:
        """What is connected, for the noise of a reading."""
        return f"{self._board}:{self._points[0]}:{self._points[1]}"

    def occupied_by_other(self, board: str) -> bool:
        """Another board has its relays closed."""
        return self._board not in (None, board)

    def connect(self, board: str, socket: Probed, high: str, low: str, settled_s: float) -> None:
        """Close a board's relays; contacts bounce until `settled_s`."""
        self._board, self._socket, self._points, self._settled_s = board, socket, (high, low), settled_s

    def disconnect(self, board: str) -> None:
        """Open a board's relays; those of others stay."""
        if self._board == board:
            self._board, self._socket, self._points = None, None, ("", "")

    def connected(self, since_s: float) -> tuple[Probed, str, str] | None:
        """Socket and points that have been connected, and at rest, since a moment."""
        if self._socket is None or since_s < self._settled_s:
            return None
        high, low = self._points
        return self._socket, high, low
