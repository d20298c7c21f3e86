# pyright: strict
"""A CAN adapter that speaks Lawicel's ASCII protocol (slcan), as python-can, can-utils and the kernel do.

Commands end with CR: `S0`…`S8` bit rate, `s…` registers, `O` open, `L` listen only, `C` close, `t`/`T`
data frame with 11/29-bit identifier, `r`/`R` remote frame, `V` version, `N` serial number, `F` status.
Answers: CR for done, BEL for refused, `z`CR or `Z`CR for a frame that was sent.

Omitted: time stamps, acceptance filters, arbitration and bus load, CAN FD. Frames with 29-bit
identifiers and remote frames are sent, but the product's bus has nobody that listens to them.
"""

from typing import NamedTuple

MAX_COMMAND_BYTES = 64
MAX_STANDARD_ID = 0x7FF
DONE = b"\r"
REFUSED = b"\a"
VERSION = b"V1013\r"
SERIAL_NUMBER = b"NTL01\r"
PRODUCT_BIT_RATE_COMMAND = b"S6"
_HEX = frozenset(b"0123456789ABCDEFabcdef")


class CanFrameOut(NamedTuple):
    """A frame that the station has sent."""

    identifier: int
    data: bytes


class SlcanAdapter:
    """One adapter; `feed` takes the station's bytes, `frame_line` makes a line of a received frame."""

    def __init__(self) -> None:
        self._rest = b""
        self._open = False
        self._listen_only = False
        self._bit_rate = b""

    @property
    def hears_bus(self) -> bool:
        """The channel is open at the bus's bit rate."""
        return self._open and self._bit_rate == PRODUCT_BIT_RATE_COMMAND

    def disconnect(self) -> None:
        """The station has gone: an incomplete command is forgotten, the channel stays as it is."""
        self._rest = b""

    def feed(self, data: bytes) -> tuple[bytes, list[CanFrameOut]]:
        """The adapter's answers to these bytes, and the frames they put on the bus."""
        *commands, self._rest = (self._rest + data).split(b"\r")
        answers: list[bytes] = []
        frames: list[CanFrameOut] = []
        for command in commands:
            answers.append(self._command(command.lstrip(b"\n"), frames))
        if len(self._rest) > MAX_COMMAND_BYTES:
            self._rest = b""
            answers.append(REFUSED)
        return b"".join(answers), frames

    def frame_line(self, identifier: int, data: bytes) -> bytes:
        """A frame from the bus as the adapter reports it; empty while the channel does not hear the bus."""
        if not self.hears_bus:
            return b""
        head = f"t{identifier:03X}" if identifier <= MAX_STANDARD_ID else f"T{identifier:08X}"
        return f"{head}{len(data)}{data.hex().upper()}\r".encode("ascii")

    def _command(self, command: bytes, frames: list[CanFrameOut]) -> bytes:
        match command[:1]:
            case b"":
                return DONE
            case b"t" | b"T" | b"r" | b"R":
                return self._send(command, frames)
            case b"V":
                return VERSION if len(command) == 1 else REFUSED
            case b"N":
                return SERIAL_NUMBER if len(command) == 1 else REFUSED
            case b"F":
                return b"F00\r" if self._open and len(command) == 1 else REFUSED
            case b"S" | b"s":
                return self._set_bit_rate(command)
            case b"O" | b"L" | b"C" if len(command) == 1:
                return self._switch(command)
            case _:
                return REFUSED

    def _set_bit_rate(self, command: bytes) -> bytes:
        """Refused while the channel is open (Lawicel CANUSB manual, commands S and s)."""
        known = (
            len(command) == 2 and command[1:] in b"0123456789" if command[:1] == b"S" else len(command) == 5
        )
        if self._open or not known:
            return REFUSED
        self._bit_rate = command
        return DONE

    def _switch(self, command: bytes) -> bytes:
        if command == b"C":
            self._open = False
            return DONE
        if self._open or not self._bit_rate:
            return REFUSED
        self._open, self._listen_only = True, command == b"L"
        return DONE

    def _send(self, command: bytes, frames: list[CanFrameOut]) -> bytes:
        extended = command[:1] in (b"T", b"R")
        remote = command[:1] in (b"r", b"R")
        id_end = 9 if extended else 4
        body = command[1:]
        if not self._open or self._listen_only or not all(byte in _HEX for byte in body):
            return REFUSED
        length = command[id_end : id_end + 1]
        if not length or length not in b"012345678":
            return REFUSED
        data = command[id_end + 1 :]
        identifier = int(command[1:id_end], 16)
        if len(data) != (0 if remote else 2 * int(length)):
            return REFUSED
        if identifier > (0x1FFF_FFFF if extended else MAX_STANDARD_ID):
            return REFUSED
        if self.hears_bus and not remote and not extended:
            frames.append(CanFrameOut(identifier, bytes.fromhex(data.decode("ascii"))))
        return b"Z\r" if extended else b"z\r"
