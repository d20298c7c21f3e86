# pyright: strict
"""What the command ports of all stands have in common: a line in, a line out, and a stream of samples.

A line is a word, then its arguments with commas between. The answer is a figure that was asked for, `OK`,
`OK duration_s`, or `ERR code text`. Codes below 10 are the port's (1 unknown command, 2 arguments), those
from 10 up the stand's own. Every port answers `*IDN?`, `CAL?` and `STRE`.

Sample k of a stream is taken k / rate after `STRE ON,rate_hz`. Samples of the past are taken before a command
or a fault changes anything.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Mapping
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dut_emulator.interfaces import BenchModelError, StandRefusal

FloatArray = NDArray[np.float64]
T = TypeVar("T")
Commands = Mapping[str, Container[int]]
"""Commands → how many arguments each takes."""

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
_INSTANT_TOLERANCE_S = 1e-9
MOST = 1e9
"""No stand's argument is larger, in whatever unit; squares of it are still numbers."""
_COMMON: Commands = {"*IDN?": (0,), "CAL?": (0,), "STRE": (1, 2)}


class Refused(Exception):
    """A command is not carried out, and nothing has changed. Its text is the answer."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"ERR {code} {text}")


class Stream(Protocol):
    """What a stand sends besides its answers."""

    @property
    def sample_bytes(self) -> int:
        """Size of one sample."""
        ...

    def switch(self, arguments: list[str], now_s: float) -> None:
        """Do what `STRE` says. Raises Refused."""
        ...

    def sample_to(self, now_s: float) -> None:
        """Take the samples that are due up to now."""
        ...

    def hand_over(self, to_s: float) -> bytes:
        """The samples of (last call, to_s]."""
        ...

    def next_event_s(self) -> float | None:
        """When it will next have something; None while it is off."""
        ...


class SampleStream:
    """A stand's samples at even times. See `Stream`.

    Args:
        rows: what is sampled at times (n,) in s: (n, columns), called once for each time, in order.
        columns: how many doubles a sample has, its time included.
        max_rate_hz: the fastest that `STRE ON` may ask for.
    """

    def __init__(self, rows: Callable[[FloatArray], FloatArray], columns: int, max_rate_hz: float) -> None:
        self._rows, self._columns, self._max_rate_hz = rows, columns, max_rate_hz
        self._rate_hz = 0.0
        self._started_s = 0.0
        self._taken = 0
        self._pending: list[bytes] = []

    @property
    def sample_bytes(self) -> int:
        """See `Stream`."""
        return 8 * self._columns

    def switch(self, arguments: list[str], now_s: float) -> None:
        """`ON,rate_hz` or `OFF`. Raises Refused."""
        match [arguments[0].upper(), *arguments[1:]]:
            case ["OFF"]:
                self._rate_hz = 0.0
            case ["ON", text]:
                rate_hz = number(text)
                if not 0 < rate_hz <= self._max_rate_hz:
                    limits = f"between 0 and {self._max_rate_hz:g} Hz"
                    raise Refused(ERR_ARGUMENTS, f"the stream's rate must lie {limits}")
                self._rate_hz, self._started_s, self._taken = rate_hz, now_s, 0
            case _:
                raise Refused(ERR_ARGUMENTS, "STRE takes OFF, or ON and a rate")

    def sample_to(self, now_s: float) -> None:
        """See `Stream`."""
        if not self._rate_hz:
            return
        ripe = math.floor((now_s - self._started_s + _INSTANT_TOLERANCE_S) * self._rate_hz) + 1
        if ripe > self._taken:
            rows = self._rows(self._started_s + np.arange(self._taken, ripe) / self._rate_hz)
            assert rows.shape == (ripe - self._taken, self._columns)
            self._pending.append(rows.astype("<f8").tobytes())
            self._taken = ripe

    def hand_over(self, to_s: float) -> bytes:
        """See `Stream`."""
        self.sample_to(to_s)
        samples = b"".join(self._pending)
        self._pending.clear()
        return samples

    def next_event_s(self) -> float | None:
        """When the next sample is due."""
        return self._started_s + self._taken / self._rate_hz if self._rate_hz else None


class CommandPort(ABC):
    """A stand behind its command port: the base of all of them. See `StandModel`.

    Args:
        identification: the answer to `*IDN?`, 'maker,model,serial,version'.
        calibration_due: the answer to `CAL?`: ISO date until which the stand's own calibration holds.
        stream: what it sends on its stream link.
    """

    STAND: ClassVar[str]
    """What it is, with its article: 'a rate table'."""
    COMMANDS: ClassVar[Commands]
    """Its own ones."""
    FAULTS: ClassVar[tuple[str, ...]]

    def __init__(self, identification: str, calibration_due: str, stream: Stream) -> None:
        self._identification, self._calibration_due = identification, calibration_due
        self._stream = stream

    @property
    def sample_bytes(self) -> int:
        """Size of one sample of its stream."""
        return self._stream.sample_bytes

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        self._stream.sample_to(now_s)
        word, _, rest = line.strip().partition(" ")
        word = word.upper()
        arguments = [part.strip() for part in rest.split(",")] if rest.strip() else []
        counts = _COMMON.get(word) or self._commands().get(word)
        try:
            if counts is None:
                raise Refused(ERR_UNKNOWN, f"unknown command {word[:20]}")
            if len(arguments) not in counts:
                raise Refused(ERR_ARGUMENTS, f"{word} does not take {len(arguments)} arguments")
            match word:
                case "*IDN?":
                    return self._identification
                case "CAL?":
                    return self._calibration_due
                case "STRE":
                    self._stream.switch(arguments, now_s)
                    return "OK"
                case _:
                    return self._answer(word, arguments, now_s)
        except Refused as refusal:
            return str(refusal)

    def advance(self, to_s: float) -> bytes:
        """Stream samples of (last advance, to_s]."""
        return self._stream.hand_over(to_s)

    def next_event_s(self) -> float | None:
        """When the stream will next have something."""
        return self._stream.next_event_s()

    def inject(self, fault: str, now_s: float) -> None:
        """Raises BenchModelError for a fault that this stand cannot have."""
        if fault not in self.FAULTS:
            raise BenchModelError(
                f"{self.STAND} cannot have the fault '{fault}'; it can {', '.join(self.FAULTS)}"
            )
        self._stream.sample_to(now_s)
        self._inject(fault, now_s)

    def _commands(self) -> Commands:
        """Its own commands as this stand is fitted out."""
        return self.COMMANDS

    @abstractmethod
    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        """The answer to one of `COMMANDS` with a number of arguments that it takes. Raises Refused."""

    @abstractmethod
    def _inject(self, fault: str, now_s: float) -> None:
        """One of `FAULTS`."""


def number(text: str) -> float:
    """An argument as a finite number. Raises Refused."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refused(ERR_ARGUMENTS, f"'{text[:20]}' is not a number")
    if abs(value) > MOST:
        raise Refused(ERR_ARGUMENTS, f"'{text[:20]}' is beyond {MOST:g}")
    return value


def named_numbers(arguments: list[str]) -> dict[str, float]:
    """Arguments 'parameter=value'. Raises Refused."""
    values: dict[str, float] = {}
    for argument in arguments:
        name, equals, text = argument.partition("=")
        if not equals:
            raise Refused(ERR_ARGUMENTS, f"'{argument[:40]}' is no parameter=value")
        values[name.strip()] = number(text)
    return values


def ok(duration_s: float | StandRefusal) -> str:
    """The answer of a command that takes a time. Raises Refused where the stand refuses."""
    return f"OK {accepted(duration_s):.9f}"


def accepted(outcome: T | StandRefusal) -> T:
    """What a stand has done. Raises Refused where it refuses."""
    if isinstance(outcome, StandRefusal):
        raise Refused(outcome.code, outcome.text)
    return outcome
