# pyright: strict
"""A voltmeter on RS-232, as paper 4 reads its gyros with: `scanning_voltmeter` at the end of a line.

One line (8N1, 9600 baud), one session: errors with `SYST:ERR?`, Ctrl-C clears the device. Commands that come
while an answer is awaited wait in the input buffer. Answers take their time on the wire.

Omitted: DTR/DSR (no byte is lost), parity and framing errors, the time that a command takes to arrive.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from dut_emulator.instruments.scanning_voltmeter import AveragedOutputs, ScanningVoltmeter
from dut_emulator.instruments.scpi import MAX_LINE_BYTES, ScpiError, Session

BAUD, BITS_PER_CHARACTER = 9600, 10
MAX_WAITING_COMMANDS = 64
DEVICE_CLEAR = b"\x03"


class SerialOutput(NamedTuple):
    """Bytes on the line, with the time of the last one."""

    time_s: float
    data: bytes


@dataclass
class _LineSession(Session):
    """Knows how many errors there were, whether or not the queue could hold them."""

    reported: int = 0

    def report(self, error: ScpiError) -> None:
        self.reported += 1
        super().report(error)


class SerialMultimeter:
    """The voltmeter at the end of its line. Bench time comes in; calls never go back."""

    def __init__(
        self,
        outputs: AveragedOutputs,
        seed: int,
        serial: str,
        points: tuple[str, ...] = ("OUT_X", "OUT_Y", "OUT_Z"),
    ) -> None:
        self._meter = ScanningVoltmeter(outputs, seed, serial, points)
        self._session = _LineSession()
        self._input = bytearray()
        self._commands: deque[str] = deque()
        """Commands of the lines that have come; '' ends a line."""
        self._answers: list[str] = []
        self._line_free_s = 0.0
        self._sent: deque[SerialOutput] = deque()

    def receive(self, data: bytes, now_s: float) -> None:
        """Bytes have come over the line."""
        self._run_to(now_s)
        for number, segment in enumerate(data.split(DEVICE_CLEAR)):
            if number:
                self._clear()
            self._take_in(segment, now_s)

    def next_event_s(self) -> float | None:
        """When the next aperture ends or the next answer has arrived."""
        times = [self._meter.next_event_s(), self._sent[0].time_s if self._sent else None]
        return min((time_s for time_s in times if time_s is not None), default=None)

    def advance(self, to_s: float) -> list[SerialOutput]:
        """Answers that have arrived since the last call."""
        self._run_to(to_s)
        arrived: list[SerialOutput] = []
        while self._sent and self._sent[0].time_s <= to_s:
            arrived.append(self._sent.popleft())
        return arrived

    def _take_in(self, data: bytes, now_s: float) -> None:
        """Lines become commands; a line too long, or for which there is no room, is lost as a whole."""
        self._input += data
        *lines, rest = bytes(self._input).split(b"\n")
        for line in lines:
            parts = [part.strip() for part in line.decode("latin-1").split(";")]
            if len(line) > MAX_LINE_BYTES or len(self._commands) + len(parts) > MAX_WAITING_COMMANDS:
                self._session.report(ScpiError(-363))
                continue
            self._commands += [*filter(None, parts), ""]
            self._work(now_s)
        if len(rest) > MAX_LINE_BYTES:
            rest = b""
            self._session.report(ScpiError(-363))
        self._input = bytearray(rest)

    def _run_to(self, to_s: float) -> None:
        """Apertures that end until then, and what has waited for them."""
        while (end_s := self._meter.next_event_s()) is not None and end_s <= to_s:
            self._meter.integrate()
            self._work(end_s)

    def _work(self, now_s: float) -> None:
        """Commands in their order, until one has to wait for its readings."""
        while True:
            answer = self._meter.take_answer()
            if answer is not None:
                self._answers.append(answer)
            if self._meter.awaited or not self._commands:
                return
            command = self._commands.popleft()
            if not command:
                self._send(now_s)
                continue
            reported = self._session.reported
            answer = self._meter.execute(command, self._session, now_s)
            if answer is not None:
                self._answers.append(answer)
            if self._session.reported > reported:
                self._skip_line()

    def _skip_line(self) -> None:
        """After an error a parser has lost its place."""
        while self._commands and self._commands[0]:
            self._commands.popleft()

    def _send(self, now_s: float) -> None:
        if not self._answers:
            return
        data = ";".join(self._answers).encode("latin-1") + b"\r\n"
        self._answers.clear()
        self._line_free_s = max(now_s, self._line_free_s) + len(data) * BITS_PER_CHARACTER / BAUD
        self._sent.append(SerialOutput(self._line_free_s, data))

    def _clear(self) -> None:
        """Ctrl-C: input, acquisition and answers are dropped; settings and errors stay."""
        self._input.clear()
        self._commands.clear()
        self._answers.clear()
        self._sent.clear()
        self._line_free_s = 0.0
        self._meter.discard()
