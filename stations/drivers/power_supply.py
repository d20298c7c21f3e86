"""A SCPI power supply with a channel for each socket."""

from stations.drivers.scpi import ScpiSession

CURRENT_LIMIT_REACHED = 0.98
"""Share of the limit above which the supply counts as limiting (its own reading is that good)."""


class ScpiPowerSupply:
    """Implements `protocol.instruments.PowerSupply`. Sessions are shared by the sockets of a bench."""

    def __init__(self, session: ScpiSession) -> None:
        self._session = session

    def configure(self, channel: int, voltage_v: float, current_limit_a: float) -> None:
        """Set voltage and current limit of a channel. Raises LinkError."""
        self._session.set(f"VOLT {voltage_v:.4f},(@{channel})")
        self._session.set(f"CURR {current_limit_a:.4f},(@{channel})")

    def switch(self, channel: int, on: bool) -> None:
        """Switch a channel's output. Raises LinkError."""
        self._session.set(f"OUTP {'ON' if on else 'OFF'},(@{channel})")

    def is_on(self, channel: int) -> bool:
        """Whether a channel's output is on, by the supply's own word. Raises LinkError."""
        return self._session.query(f"OUTP? (@{channel})").upper() in ("1", "ON")

    def measure_voltage_v(self, channel: int) -> float:
        """Voltage at a channel's output. Raises LinkError."""
        return self._session.query_number(f"MEAS:VOLT? (@{channel})")

    def measure_current_a(self, channel: int) -> float:
        """Current out of a channel. Raises LinkError."""
        return self._session.query_number(f"MEAS:CURR? (@{channel})")


class SocketSupply:
    """The supply as one socket sees it: bound to its channel.

    Attributes:
        set_voltage_v: what the output should have now; None while it should be off.
    """

    def __init__(self, supply: ScpiPowerSupply, channel: int) -> None:
        self._supply = supply
        self._channel = channel
        self._configured_v = 0.0
        self._current_limit_a = 0.0
        self.set_voltage_v: float | None = None

    def configure(self, voltage_v: float, current_limit_a: float) -> None:
        """Set voltage and current limit. Raises LinkError."""
        self._supply.configure(self._channel, voltage_v, current_limit_a)
        self._configured_v, self._current_limit_a = voltage_v, current_limit_a

    def switch(self, on: bool) -> None:
        """Switch the output. Raises LinkError."""
        self._supply.switch(self._channel, on)
        self.set_voltage_v = self._configured_v if on else None

    def limits_current(self) -> bool:
        """Whether the unit draws what the limit allows, so that the voltage gives way. Raises LinkError."""
        return self.measure_current_a() >= CURRENT_LIMIT_REACHED * self._current_limit_a

    def is_on(self) -> bool:
        """Whether the output is on. Raises LinkError."""
        return self._supply.is_on(self._channel)

    def measure_voltage_v(self) -> float:
        """Voltage at the output. Raises LinkError."""
        return self._supply.measure_voltage_v(self._channel)

    def measure_current_a(self) -> float:
        """Current drawn. Raises LinkError."""
        return self._supply.measure_current_a(self._channel)
