# pyright: strict
"""The heartbeat on CAN: state, error flags, supply and temperature in GNC_STATUS."""

from functools import lru_cache

from protocol.can_database import GNC_STATUS, CanFrame, UnitState, encode_can

ERROR_FLAGS = ("imu", "gnss", "memory", "flash", "timer", "adc", "io", "link")


@lru_cache(maxsize=1024)
def status_frame(state: UnitState, errors: frozenset[str], supply_v: float, temperature_c: float) -> CanFrame:
    """A heartbeat with counter 0; cached, because ten a second are sent and few differ."""
    signals = {f"{flag}_error": int(flag in errors) for flag in ERROR_FLAGS}
    return encode_can(
        GNC_STATUS,
        {
            "state": int(state),
            "heartbeat_counter": 0,
            **signals,
            "supply_voltage": supply_v,
            "temperature": temperature_c,
        },
    )
