# pyright: strict
"""Commands and answers on a unit's RS-422, for units that speak the frames of `protocol.frames`.

A command is answered after `REPLY_LATENCY_S`. A frame that is no command (wrong CRC, noise, bit 7 set) is not
answered; one of unknown type gets UNKNOWN, one of wrong length or values INVALID.
"""

from collections.abc import Iterator

from protocol.frames import Frame, FrameParser, encode_frame
from protocol.unit_commands import IDENTITY_LAYOUT, REPLY_BIT, ReplyStatus

REPLY_LATENCY_S = 0.5e-3
FLASH_WRITE_S = 20e-3
RESET_DELAY_S = 5e-3
SILENCE_S = 20e-3
"""After this the parser gives up an incomplete frame."""


class CommandLink:
    """What arrives from a boot on."""

    def __init__(self, now_s: float) -> None:
        self._parser = FrameParser()
        self._last_received_s = now_s

    @property
    def crc_errors(self) -> int:
        """Frames with a wrong CRC so far."""
        return self._parser.statistics.crc_errors

    def commands(self, data: bytes, now_s: float) -> Iterator[Frame]:
        """The commands that are whole with these bytes."""
        found = self._parser.flush() if now_s - self._last_received_s > SILENCE_S else []
        self._last_received_s = now_s
        for item in (*found, *self._parser.feed(data)):
            for frame in (item,) if isinstance(item, Frame) else item.frames():
                if not frame.type & REPLY_BIT:
                    yield frame


def reply(command: Frame, payload: bytes) -> bytes:
    """The frame that answers a command. `payload`: its first byte is a `ReplyStatus`."""
    return encode_frame(command.type | REPLY_BIT, command.sequence, payload)


def identity(serial: str, firmware_version: str, hardware_revision: str) -> bytes:
    """What follows the status in the reply to IDENTIFY."""
    texts = (text.encode("ascii") for text in (serial[:32], firmware_version, hardware_revision))
    return IDENTITY_LAYOUT.pack(ReplyStatus.DONE, *texts)[1:]
