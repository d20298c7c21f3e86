"""The board under a socket: relays to the test points, the AD switch, the presence contact."""

from stations.drivers.clock import BranchClock
from stations.drivers.scpi import ScpiSession

RELAY_SETTLING_S = 0.005


class ScpiSocketBoard:
    """Implements `protocol.instruments.SocketBoard`; lets relays settle on the branch's clock.

    The AD switch and the presence contact are apart from the routing: a branch may use them while
    another one measures.
    """

    def __init__(self, session: ScpiSession, clock: BranchClock) -> None:
        self._session = session
        self._clock = clock

    def route(self, high: str, low: str) -> None:
        """Connect the instruments' inputs to two test points, and nothing else. Raises LinkError."""
        self._session.set(f"ROUT:CLOS (@{high},{low})")
        self._settle()

    def open_all(self) -> None:
        """Open every relay. Raises LinkError."""
        self._session.set("ROUT:OPEN:ALL")

    def set_ad_switch(self, source: str) -> None:
        """Route a source to its AD channel. Raises LinkError."""
        self._session.set(f"AD:SWIT {source}")
        self._settle()

    def unit_present(self) -> bool:
        """Whether the presence contact is closed. Raises LinkError."""
        return self._session.query("SENS:PRES?").upper() in ("1", "ON")

    def _settle(self) -> None:
        self._clock.sleep_for(RELAY_SETTLING_S)
