"""Opening serial ports by URL or device name, with errors a person can act on."""

from typing import Any

import serial

from protocol.errors import Fault, LinkError
from stations.drivers.url_handlers.protocol_lockstep import Serial as LockstepPort

HANDLERS = "stations.drivers.url_handlers"
MAX_READS_AT_ONCE = 4096

if HANDLERS not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(HANDLERS)


def open_port(url: str, *, baud_rate: int, where: str) -> Any:
    """A serial port that never blocks on reading (time-out 0).

    Raises:
        LinkError: it cannot be opened.
    """
    try:
        return serial.serial_for_url(url, baudrate=baud_rate, timeout=0)
    except (serial.SerialException, OSError, ValueError) as error:
        raise LinkError(
            f"The port {url} cannot be opened: {error}.",
            where=where,
            fault=Fault.STATION,
            remedy="check that the bench is up and that nobody else has the port open (testloom doctor).",
        ) from None


def read_available(port: Any, where: str) -> bytes:
    """All bytes that a port has now, without waiting.

    Raises:
        LinkError: the port is gone.
    """
    data = bytearray()
    try:
        for _ in range(MAX_READS_AT_ONCE):
            waiting = port.in_waiting
            if not waiting:
                break
            data += port.read(waiting)
    except (serial.SerialException, OSError) as error:
        raise lost_port(error, where) from None
    return bytes(data)


def lost_port(error: Exception, where: str) -> LinkError:
    """The error for a port that was open and does not work any more: never the unit's fault."""
    return LinkError(
        f"The serial port was lost: {error}.",
        where=where,
        fault=Fault.STATION,
        remedy="check the bench's server or the adapter's cable; the station opens the port again.",
    )


__all__ = ["LockstepPort", "lost_port", "open_port", "read_available"]
