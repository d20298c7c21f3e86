# pyright: strict
"""A 6½-digit DC voltmeter with switched inputs, over SCPI: what is behind the line of `serial_multimeter`.

A reading is the true mean of the input over the aperture, times the meter's gain, plus zero and noise,
rounded to the resolution of range and aperture. Accuracy by range is that of a 34401A after one year, which
is the paper's ±(0.0035 % of reading + 0.0005 % of range) at 10 V; its bounds are three standard deviations.

| command | |
|---|---|
| `SYST:REM` `SYST:LOC` | own commands need remote; at power-on it is local |
| `CONF:VOLT:DC [range]` `CONF?` | one reading, 10 power-line cycles; automatic range unless given |
| `VOLT:DC:RANG r` `?` · `RANG:AUTO ON` `?` | 0.1, 1, 10, 100, 1000 V; overload above 1.2 of it: `9.9E+37` |
| `VOLT:DC:NPLC n` `?` | 0.02, 0.2, 1, 10, 100 cycles of 20 ms |
| `ROUT:CHAN n` `?` · `ROUT:SCAN (@1,2,3)` `?` | inputs that a reading goes through; relays settle in 5 ms |
| `SAMP:COUN n` `?` | times through all inputs; 512 readings at most |
| `READ?` · `INIT` `FETC?` · `MEAS:VOLT:DC? [range]` · `ABOR` | answers come when the last aperture is over |

Omitted: automatic zero, the time of a change of range, input resistance, rejection of hum.
"""

import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dut_emulator.instruments.accuracy import Accuracy, Reading
from dut_emulator.instruments.scpi import (
    OVERLOAD,
    Call,
    Handler,
    ScpiError,
    ScpiInstrument,
    boolean,
    number,
)

POWER_LINE_CYCLE_S = 0.02
RELAY_SETTLING_S = 5e-3
MAX_READINGS = 512
OVER_RANGE = 1.2
BOUNDS: dict[float, tuple[float, float]] = {
    0.1: (5.0e-5, 3.5e-5),
    1.0: (4.0e-5, 7e-6),
    10.0: (3.5e-5, 5e-6),
    100.0: (4.5e-5, 6e-6),
    1000.0: (4.5e-5, 1.0e-5),
}
"""Range in V → maximum permissible error as a part of the reading and a part of the range."""
RESOLUTION: dict[float, float] = {0.02: 1e-4, 0.2: 1e-5, 1.0: 3e-6, 10.0: 1e-6, 100.0: 3e-7}
"""Power-line cycles → least step as a part of the range."""
BOUND_TO_DEVIATION = 3.0
NOISE_TO_RESOLUTION = 0.3
DEFAULT_CYCLES, DEFAULT_RANGE_V = 10.0, 10.0

_LIST = re.compile(r"\(@(\d(?:,\d)*)\)")


class AveragedOutputs(Protocol):
    """What the inputs are wired to."""

    def mean_voltage_v(self, point: str, begin_s: float, end_s: float) -> float:
        """True mean of a point's voltage over an aperture that has just ended."""
        ...


@dataclass(frozen=True)
class _Aperture:
    point: str
    begin_s: float
    end_s: float


class ScanningVoltmeter(ScpiInstrument):
    """The instrument behind the line; `points[n − 1]` is wired to input n."""

    def __init__(self, outputs: AveragedOutputs, seed: int, serial: str, points: tuple[str, ...]) -> None:
        super().__init__(f"Testloom,DMM6S,{serial},1.0")
        self._outputs = outputs
        self._seed = seed
        self._points = points
        self._remote = False
        self._apertures: deque[_Aperture] = deque()
        self._readings: list[str] = []
        self.awaited = False
        """An answer is due as soon as the acquisition is complete."""
        self._configure()
        self._channels: tuple[int, ...] = (1,)
        self._closed = 0  # the input whose relay is
        for pattern, handler in (
            ("CONFigure:VOLTage[:DC]", self._set_configuration),
            ("CONFigure?", self._configuration),
            ("[SENSe:]VOLTage[:DC]:RANGe", self._set_range),
            ("[SENSe:]VOLTage[:DC]:RANGe?", _query(lambda: _signed(self._range_now_v))),
            ("[SENSe:]VOLTage[:DC]:RANGe:AUTO", self._set_automatic),
            ("[SENSe:]VOLTage[:DC]:RANGe:AUTO?", _query(lambda: str(int(self._range_v is None)))),
            ("[SENSe:]VOLTage[:DC]:NPLCycles", self._set_cycles),
            ("[SENSe:]VOLTage[:DC]:NPLCycles?", _query(lambda: _signed(self._cycles))),
            ("ROUTe:CHANnel", self._set_channel),
            ("ROUTe:CHANnel?", _query(lambda: str(self._channels[0]))),
            ("ROUTe:SCAN", self._set_scan),
            ("ROUTe:SCAN?", _query(lambda: f"(@{','.join(map(str, self._channels))})")),
            ("SAMPle:COUNt", self._set_count),
            ("SAMPle:COUNt?", _query(lambda: str(self._count))),
            ("INITiate[:IMMediate]", self._initiate),
            ("FETCh?", self._fetch),
            ("READ?", self._read),
            ("MEASure:VOLTage[:DC]?", self._measure),
            ("ABORt", self._abort),
        ):
            self.commands.add(pattern, self._in_remote(handler))
        self.commands.add("SYSTem:REMote", lambda call: self._set_remote(call, on=True))
        self.commands.add("SYSTem:LOCal", lambda call: self._set_remote(call, on=False))

    def reset(self, now_s: float) -> None:  # noqa: ARG002 - see the base class
        """As at power-on, but for remote."""
        self._configure()
        self._channels = (1,)
        self.discard()

    def discard(self) -> None:
        """Throw away what is acquired, being acquired and awaited."""
        self._apertures.clear()
        self._readings.clear()
        self.awaited = False

    def next_event_s(self) -> float | None:
        """End of the aperture that is open or next."""
        return self._apertures[0].end_s if self._apertures else None

    def integrate(self) -> None:
        """The next aperture is over: its reading."""
        aperture = self._apertures.popleft()
        true_v = self._outputs.mean_voltage_v(aperture.point, aperture.begin_s, aperture.end_s)
        self._range_now_v = range_v = self._range_for(true_v)
        if abs(true_v) > OVER_RANGE * range_v:
            reading_v = math.copysign(OVERLOAD, true_v)
        else:
            reading_v = self._reading(range_v).of(true_v, aperture.end_s, aperture.point)
        self._readings.append(_signed(reading_v))

    def take_answer(self) -> str | None:
        """The readings, once they are awaited and complete."""
        if not self.awaited or self._apertures:
            return None
        self.awaited = False
        return ",".join(self._readings)

    # --- settings

    def _configure(self, range_v: float | None = None) -> None:
        self._cycles, self._count = DEFAULT_CYCLES, 1
        self._hold_range(range_v)

    def _hold_range(self, range_v: float | None) -> None:
        """A range, or None for an automatic one."""
        self._range_v = range_v
        self._range_now_v = range_v or DEFAULT_RANGE_V

    def _set_configuration(self, call: Call) -> None:
        self._configure(_range_named(call))
        self.discard()

    def _configuration(self, call: Call) -> str:
        call.exactly(0)
        resolution_v = self._range_now_v * RESOLUTION[self._cycles]
        return f'"VOLT {_signed(self._range_now_v)},{_signed(resolution_v)}"'

    def _set_range(self, call: Call) -> None:
        call.exactly(1)
        self._hold_range(_range_named(call))
        self.discard()

    def _set_automatic(self, call: Call) -> None:
        on = boolean(call.exactly(1)[0])
        self._range_v = None if on else self._range_now_v
        self.discard()

    def _set_cycles(self, call: Call) -> None:
        wanted = number(call.exactly(1)[0], min(RESOLUTION), max(RESOLUTION))
        self._cycles = min(cycles for cycles in RESOLUTION if cycles >= wanted)
        self.discard()

    def _set_channel(self, call: Call) -> None:
        self._select(call.exactly(1)[0])

    def _set_scan(self, call: Call) -> None:
        text = call.exactly(1)[0].replace(" ", "")
        match = _LIST.fullmatch(text)
        if match is None:
            raise ScpiError(-171, text[:40])
        self._select(*match[1].split(","))

    def _select(self, *names: str) -> None:
        channels = tuple(number(name, 1, len(self._points)) for name in names)
        if any(channel % 1 for channel in channels):
            raise ScpiError(-224, names[0])
        self._channels = tuple(int(channel) for channel in channels)
        self.discard()

    def _set_count(self, call: Call) -> None:
        self._count = int(number(call.exactly(1)[0], 1, MAX_READINGS))
        self.discard()

    def _set_remote(self, call: Call, *, on: bool) -> None:
        call.exactly(0)
        self._remote = on

    # --- readings

    def _initiate(self, call: Call) -> None:
        call.exactly(0)
        if self._apertures:
            raise ScpiError(-221, "acquisition is running")
        if self._count * len(self._channels) > MAX_READINGS:
            raise ScpiError(-221, f"more than {MAX_READINGS} readings")
        self.discard()
        now_s = call.now_s
        for channel in self._channels * self._count:
            begin_s = now_s + (RELAY_SETTLING_S if channel != self._closed else 0.0)
            now_s, self._closed = begin_s + self._cycles * POWER_LINE_CYCLE_S, channel
            self._apertures.append(_Aperture(self._points[channel - 1], begin_s, now_s))

    def _abort(self, call: Call) -> None:
        call.exactly(0)
        self.discard()

    def _fetch(self, call: Call) -> None:
        call.exactly(0)
        if not self._apertures and not self._readings:
            raise ScpiError(-230, "nothing acquired")
        self.awaited = True

    def _read(self, call: Call) -> None:
        self._initiate(call)
        self.awaited = True

    def _measure(self, call: Call) -> None:
        self._set_configuration(call)
        self._read(Call((), call.now_s))

    def _range_for(self, true_v: float) -> float:
        """The range that is set, or the least one that holds the voltage."""
        if self._range_v is not None:
            return self._range_v
        return min((one for one in BOUNDS if abs(true_v) <= OVER_RANGE * one), default=max(BOUNDS))

    def _reading(self, range_v: float) -> Reading:
        """Gain and zero belong to the range, resolution and noise to the aperture besides."""
        of_reading, of_range = BOUNDS[range_v]
        step_v = RESOLUTION[self._cycles] * range_v
        accuracy = Accuracy(
            gain_uncertainty=of_reading / BOUND_TO_DEVIATION,
            zero_uncertainty=of_range * range_v / BOUND_TO_DEVIATION,
            noise_deviation=NOISE_TO_RESOLUTION * step_v,
            resolution=step_v,
        )
        return Reading(accuracy, self._seed, f"volt {range_v:g}")

    def _in_remote(self, handler: Handler) -> Handler:
        def handled(call: Call) -> str | None:
            if not self._remote:
                raise ScpiError(-200, "Command not allowed in local: send SYST:REM")
            return handler(call)

        return handled


def _range_named(call: Call) -> float | None:
    """The least range that holds what is named; None for automatic."""
    if not call.parameters or call.exactly(1)[0].upper() in ("DEF", "AUTO"):
        return None
    wanted = number(call.exactly(1)[0], 0.0, max(BOUNDS))
    return min(range_v for range_v in BOUNDS if range_v >= wanted)


def _query(value: Callable[[], str]) -> Handler:
    def handler(call: Call) -> str:
        call.exactly(0)
        return value()

    return handler


def _signed(value: float) -> str:
    """As such meters write it: sign, nine digits, exponent."""
    return f"{value:+.8E}"
