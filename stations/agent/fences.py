# pyright: strict
"""Which leases were here before: a command that comes again, or too late, is known by its fence."""

from protocol.attempts import Lease

FENCE_WINDOW = 10_000
"""Fences grow over the whole line: one this far below the newest seen is stale, whoever it was for."""


class FenceMemory:
    """The newest fence that was started on each socket and for each unit."""

    def __init__(self) -> None:
        self._on_socket: dict[str, int] = {}
        self._of_serial: dict[str, int] = {}
        self._newest = 0

    @property
    def newest(self) -> int:
        """The largest fence that was started here; 0 if none was."""
        return self._newest

    def remember(self, fence: int, socket: str, serial: str) -> None:
        """A lease was started."""
        self._newest = max(self._newest, fence)
        self._on_socket[socket] = max(fence, self.newest_on_socket(socket))
        self._of_serial[serial] = max(fence, self._of_serial.get(serial, 0))

    def newest_on_socket(self, socket: str) -> int:
        """0 if nothing was started there."""
        return self._on_socket.get(socket, 0)

    def was_here(self, lease: Lease) -> bool:
        """This very lease was started, and none for its socket or its unit since."""
        on_socket, of_serial = self.newest_on_socket(lease.socket), self._of_serial.get(lease.unit.serial)
        return on_socket == of_serial == lease.fence

    def stale_before(self, lease: Lease) -> int:
        """A lease for this socket and unit has to have a larger fence than this."""
        of_serial = self._of_serial.get(lease.unit.serial, 0)
        return max(self.newest_on_socket(lease.socket), of_serial, self._newest - FENCE_WINDOW)
