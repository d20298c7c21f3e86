# pyright: strict
"""The SCPI side of an instrument: headers, parameters, channel lists, and the error queue.

Follows SCPI-99 (volume 1, chapters 6 and 21): a mnemonic is accepted in its short and its long form in
either case, an error is queued under its standard number, and the queue is read oldest first with
`SYST:ERR?`. Every session (connection) has a queue of its own, as bench multimeters with several
interfaces do; so one socket's mistake is never read by another.

Omitted: compound headers relative to the one before (after `;` every header starts at the root),
suffixes of numbers (`5 V`), blocks, status registers beyond `*ESR?` and `*STB?`, and `*WAI`.
"""

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

MAX_QUEUED_ERRORS = 16
MAX_COMMANDS_PER_LINE = 32
MAX_LINE_BYTES = 4096
OVERLOAD = 9.9e37
"""SCPI's positive infinity: an open circuit, an overload, a signal without a period."""

STANDARD_TEXTS = {
    0: "No error",
    -101: "Invalid character",
    -102: "Syntax error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -141: "Invalid character data",
    -171: "Invalid expression",
    -200: "Execution error",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -230: "Data corrupt or stale",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
}

_EVENT_BIT_OF_CLASS = {-1: 0x20, -2: 0x10, -3: 0x08, -4: 0x04}
"""`*ESR?`: command, execution, device-dependent and query error (IEEE 488.2, 11.5.1)."""


class ScpiError(Exception):
    """A command that an instrument refuses, under its SCPI number."""

    def __init__(self, code: int, detail: str = "") -> None:
        super().__init__(code, detail)
        self.code = code
        self.detail = detail

    @property
    def entry(self) -> str:
        """As it stands in the queue: `-222,"Data out of range;VOLT 99"`."""
        return error_entry(self.code, self.detail)


def error_entry(code: int, detail: str = "") -> str:
    """An entry of the error queue. For -200 the detail is the whole text, as docs/bench.md has it."""
    text = STANDARD_TEXTS[code]
    if detail:
        text = detail if code == -200 else f"{text};{detail}"
    return f'{code},"{text}"'


@dataclass
class Session:
    """One connection to an instrument: its error queue and its event status."""

    errors: deque[str] = field(default_factory=lambda: deque[str]())
    event_status: int = 0

    def report(self, error: ScpiError) -> None:
        """Queue an error; when the queue is full its last entry becomes -350 (SCPI-99, 21.8.1)."""
        self.event_status |= _EVENT_BIT_OF_CLASS.get(-(-error.code // 100), 0)
        if len(self.errors) < MAX_QUEUED_ERRORS:
            self.errors.append(error.entry)
        else:
            self.errors[-1] = error_entry(-350)

    def next_error(self) -> str:
        """The oldest error, taken out; `0,"No error"` when there is none."""
        return self.errors.popleft() if self.errors else error_entry(0)

    def clear(self) -> None:
        """`*CLS`."""
        self.errors.clear()
        self.event_status = 0


class Call(NamedTuple):
    """What a command handler gets."""

    parameters: tuple[str, ...]
    now_s: float

    def exactly(self, count: int) -> tuple[str, ...]:
        """The parameters, if there are so many.

        Raises:
            ScpiError: -109 or -108.
        """
        if len(self.parameters) < count:
            raise ScpiError(-109)
        if len(self.parameters) > count:
            raise ScpiError(-108, self.parameters[count])
        return self.parameters


Handler = Callable[[Call], str | None]


class CommandTree:
    """Headers and their handlers. `MEASure:VOLTage[:DC]?` stands for all its short and long forms."""

    def __init__(self) -> None:
        self._handlers: dict[str, Handler] = {}

    def add(self, pattern: str, handler: Handler) -> None:
        """Register a header; brackets mark a node that may be left out, capitals the short form."""
        for spelling in _spellings(pattern):
            assert spelling not in self._handlers, spelling
            self._handlers[spelling] = handler

    def find(self, header: str) -> Handler:
        """The handler of a header as it was sent.

        Raises:
            ScpiError: -113.
        """
        handler = self._handlers.get(header.upper().removeprefix(":"))
        if handler is None:
            raise ScpiError(-113, header[:40])
        return handler


class ScpiInstrument:
    """The common commands of IEEE 488.2, and dispatch; an instrument adds its own to `commands`."""

    def __init__(self, identification: str) -> None:
        self.identification = identification
        self.commands = CommandTree()

    def reset(self, now_s: float) -> None:
        """`*RST`: to be given by the instrument."""
        raise NotImplementedError

    def execute(self, line: str, session: Session, now_s: float) -> str | None:
        """Carry out one line. The answers of its queries, joined by `;`, or None if there is none.

        An error goes to the session's queue and ends the line, as a parser that lost its place would.
        """
        answers: list[str] = []
        try:
            for header, parameters in _split_line(line):
                common = self._common(header, parameters, session, now_s)
                answer = common if common is not None else self._own(header, parameters, now_s)
                if answer:
                    answers.append(answer)
        except ScpiError as error:
            session.report(error)
        return ";".join(answers) if answers else None

    def _own(self, header: str, parameters: tuple[str, ...], now_s: float) -> str | None:
        return self.commands.find(header)(Call(parameters, now_s))

    def _common(self, header: str, parameters: tuple[str, ...], session: Session, now_s: float) -> str | None:
        """Answer of a common command ('' when it has none); None when it is not one."""
        name = header.upper().removeprefix(":")
        if name in ("SYST:ERR?", "SYSTEM:ERROR?", "SYST:ERR:NEXT?", "SYSTEM:ERROR:NEXT?"):
            return session.next_error()
        if not name.startswith("*"):
            return None
        if parameters:
            raise ScpiError(-108, parameters[0])
        match name:
            case "*IDN?":
                return self.identification
            case "*OPC?":
                return "1"
            case "*ESR?":
                status, session.event_status = session.event_status, 0
                return str(status)
            case "*STB?":
                return str((0x04 if session.errors else 0) | (0x20 if session.event_status else 0))
            case "*CLS":
                session.clear()
            case "*RST":
                self.reset(now_s)
            case "*OPC":
                session.event_status |= 1
            case _:
                raise ScpiError(-113, header[:40])
        return ""


def number(text: str, low: float, high: float) -> float:
    """A decimal number within a range; MIN and MAX stand for its ends.

    Raises:
        ScpiError: -104 (not a number) or -222.
    """
    named = {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}.get(text.upper())
    if named is not None:
        return named
    if not _NUMBER.fullmatch(text):
        raise ScpiError(-104, text[:40])
    value = float(text)
    if not low <= value <= high:
        raise ScpiError(-222, text[:40])
    return value


def boolean(text: str) -> bool:
    """ON, OFF, 1 or 0.

    Raises:
        ScpiError: -141.
    """
    match text.upper():
        case "ON" | "1":
            return True
        case "OFF" | "0":
            return False
        case _:
            raise ScpiError(-141, text[:40])


def expression_items(text: str, count: int) -> tuple[str, ...]:
    """The items of `(@A,B)`.

    Raises:
        ScpiError: -171, when it is no such expression or has another number of items.
    """
    match = _EXPRESSION.fullmatch(text)
    items = tuple(item.strip() for item in match.group(1).split(",")) if match else ()
    if len(items) != count or not all(items):
        raise ScpiError(-171, text[:40])
    return items


def formatted(value: float) -> str:
    """A reading as NR3 with nine significant digits; infinity as SCPI's 9.9E+37."""
    if value == float("inf"):
        value = OVERLOAD
    return f"{value:.8E}"


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_EXPRESSION = re.compile(r"\(@([^()]*)\)")
_HEADER = re.compile(r":?\*?[A-Za-z][A-Za-z0-9_]*(:[A-Za-z][A-Za-z0-9_]*)*\??")
_NODE = re.compile(r"(\[)?:?(\*?[A-Za-z]+)\]?")


def _split_line(line: str) -> list[tuple[str, tuple[str, ...]]]:
    """Headers and parameters of a line's commands."""
    if not line.isascii() or not line.isprintable():
        raise ScpiError(-101)
    commands = [part.strip() for part in line.split(";")]
    if len(commands) > MAX_COMMANDS_PER_LINE:
        raise ScpiError(-363)
    return [_split_command(command) for command in commands if command]


def _split_command(command: str) -> tuple[str, tuple[str, ...]]:
    header, _, rest = command.partition(" ")
    if not _HEADER.fullmatch(header):
        raise ScpiError(-102, command[:40])
    rest = rest.strip()
    if not rest:
        return header, ()
    # a comma inside parentheses belongs to a channel list
    parameters = [part.strip() for part in re.split(r",(?![^()]*\))", rest)]
    if not all(parameters):
        raise ScpiError(-102, command[:40])
    return header, tuple(parameters)


def _spellings(pattern: str) -> set[str]:
    """All spellings of a pattern, in capitals."""
    query = "?" if pattern.endswith("?") else ""
    spellings = {""}
    for match in _NODE.finditer(pattern.removesuffix("?")):
        optional, name = match.groups()
        forms = {name.upper(), re.sub("[a-z]", "", name)}
        longer = {f"{head}:{form}" if head else form for head in spellings for form in forms}
        spellings = longer | spellings if optional else longer
    return {spelling + query for spelling in spellings}
