# pyright: strict
"""A counter of pulses with twelve channels over SCPI: a positive and a negative one for each of six sensors.

    CONF:GATE:TIME s     a gate of so many seconds, opened by INIT
    CONF:GATE:TRIG n     a gate of n half-cycles: from the first edge of the trigger line after INIT to the
                         n-th after that
    CONF:GATE?           TIME,s or TRIG,n
    INIT  FETC?  ABOR    FETC?: twelve counts of the gate, positive and negative by turns; -230 before its end
    FETC:HALV?           n rows of twelve: the counts between every two edges of the gate
    FETC:TIM?            when the gate was opened and closed, s
    STAT:QUES:COND?      of the last gate: 1 a counter has overflown, 2 an edge was seen too late,
                         4 the unit was off in between

A counter starts from 0 at each edge and has 24 bits: past 16 777 215 it starts again, and the gate is marked.
Counts are exact at the instants of the edges: the unit is asked for its running totals there, so bench time
has to stop at `next_event_s`; where it does not, the gate is marked.

Omitted: dead time, the shape of the pulses, the error of the counter's own time base.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dut_emulator.instruments.scpi import Call, ScpiError, ScpiInstrument, number
from dut_emulator.interfaces import TriggerLine

COUNTER_BITS = 24
LEAST_GATE_S, MAX_GATE_S = 1e-6, 3600.0
MAX_HALF_CYCLES = 10_000
OVERFLOW, LATE, INTERRUPTED = 1, 2, 4
_SAME_INSTANT_S = 1e-9

Counts = NDArray[np.int64]


class PulseSource(Protocol):
    """A unit with pulse outputs."""

    def pulse_totals(self, now_s: float) -> Counts:
        """Pulses since power-on at this moment, (6, 2): sensors by positive, negative."""
        ...


class PulseCounter(ScpiInstrument):
    """See the module. `line`: the stand's trigger line, if it has one."""

    def __init__(self, source: PulseSource, line: TriggerLine | None, serial: str) -> None:
        super().__init__(f"Testloom,PC12,{serial},1.0")
        self._source, self._line = source, line
        self._gate_s: float | None = 1.0
        self._half_cycles = 1
        self._edges_s: list[float] = []
        self._totals: list[Counts] = []
        self._open = False
        self._since_s = 0.0
        self._condition = 0
        self.commands.add("CONFigure:GATE:TIME", self._gate_by_time)
        self.commands.add("CONFigure:GATE:TRIGger", self._gate_by_trigger)
        self.commands.add("CONFigure:GATE?", self._gate)
        self.commands.add("INITiate[:IMMediate]", self._initiate)
        self.commands.add("ABORt", self._abort)
        self.commands.add("FETCh?", self._fetch)
        self.commands.add("FETCh:HALVes?", self._fetch_halves)
        self.commands.add("FETCh:TIMes?", self._fetch_times)
        self.commands.add("STATus:QUEStionable:CONDition?", self._questionable)

    def reset(self, now_s: float) -> None:  # noqa: ARG002 - see the base class
        """A gate of one second, nothing counted."""
        self._gate_s, self._half_cycles = 1.0, 1
        self.discard()

    def discard(self) -> None:
        """Throw away what is counted or being counted."""
        self._open, self._edges_s, self._totals, self._condition = False, [], [], 0

    def next_event_s(self) -> float | None:
        """The gate's next edge, if one is to come."""
        if not self._open:
            return None
        if self._gate_s is not None:
            return self._since_s + self._gate_s
        return self._next_edge_s(self._since_s)

    def advance(self, now_s: float) -> None:
        """Take the totals at the edges that have come."""
        while True:
            edge_s = self.next_event_s()
            if edge_s is None or now_s < edge_s - _SAME_INSTANT_S:
                return
            if now_s > edge_s + _SAME_INSTANT_S:
                self._condition |= LATE
            self._since_s = edge_s
            self._take(edge_s, now_s)
            wanted = 2 if self._gate_s is not None else self._half_cycles + 1
            self._open = len(self._edges_s) < wanted

    def counts(self) -> Counts:
        """Of each part of the gate that is over, (n, 12)."""
        totals = np.array(self._totals).reshape(-1, 12)
        return np.mod(np.diff(totals, axis=0), 2**COUNTER_BITS)

    def _next_edge_s(self, after_s: float) -> float | None:
        return self._line.next_edge_s(after_s) if self._line is not None else None

    def _take(self, edge_s: float, now_s: float) -> None:
        totals = np.asarray(self._source.pulse_totals(now_s), dtype=np.int64).reshape(12)
        if self._totals:
            counted = totals - self._totals[-1]
            self._condition |= OVERFLOW if (counted >= 2**COUNTER_BITS).any() else 0
            self._condition |= INTERRUPTED if (counted < 0).any() else 0
        self._totals.append(totals)
        self._edges_s.append(edge_s)

    def _initiate(self, call: Call) -> None:
        call.exactly(0)
        self.advance(call.now_s)
        if self._open:
            raise ScpiError(-221, "the gate is open")
        self.discard()
        self._since_s = call.now_s
        if self._gate_s is not None:
            self._take(call.now_s, call.now_s)
        elif self._next_edge_s(call.now_s) is None:
            raise ScpiError(-221, "no edge to come on the trigger line")
        self._open = True

    def _finished(self, call: Call) -> Counts:
        call.exactly(0)
        self.advance(call.now_s)
        if self._open or not self._totals:
            raise ScpiError(-230, "the gate is open" if self._open else "nothing counted")
        return self.counts()

    def _fetch(self, call: Call) -> str:
        return _joined(np.mod(self._finished(call).sum(axis=0), 2**COUNTER_BITS))

    def _fetch_halves(self, call: Call) -> str:
        return _joined(self._finished(call).ravel())

    def _fetch_times(self, call: Call) -> str:
        self._finished(call)
        return f"{self._edges_s[0]:.9f},{self._edges_s[-1]:.9f}"

    def _questionable(self, call: Call) -> str:
        call.exactly(0)
        return str(self._condition)

    def _abort(self, call: Call) -> None:
        call.exactly(0)
        self.discard()

    def _gate_by_time(self, call: Call) -> None:
        self._gate_s = number(call.exactly(1)[0], LEAST_GATE_S, MAX_GATE_S)
        self.discard()

    def _gate_by_trigger(self, call: Call) -> None:
        count = number(call.exactly(1)[0], 1, MAX_HALF_CYCLES)
        if count != round(count):
            raise ScpiError(-224, "a number of half-cycles is whole")
        self._gate_s, self._half_cycles = None, round(count)
        self.discard()

    def _gate(self, call: Call) -> str:
        call.exactly(0)
        return f"TIME,{self._gate_s:g}" if self._gate_s is not None else f"TRIG,{self._half_cycles}"


def _joined(counts: Counts) -> str:
    return ",".join(str(count) for count in counts)
