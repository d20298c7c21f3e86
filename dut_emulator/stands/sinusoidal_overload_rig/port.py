# pyright: strict
"""The command port of the overload rig (TCP, one command a line), its trigger line and its sample stream.

    *IDN?          identification
    RUN g          OK start_up_s; ERR 12 … beyond a limit, ERR 10 … while it moves
    STOP           OK duration_s
    AXIS n         OK: body axis 1, 2 or 3 along the stroke; at rest only
    ARM            OK wait_s: the next edge of the trigger line comes in so many s; ERR 14 … not at speed
    HALF?          force,T_s,V_m_s,S_m2_s3 of the last half-cycle, force 1 or -1; ERR 14 … before there is one
    STAT?          state,overload_g,speed_rad_s,angle_deg,position_m,temperature_c
    LIM?           least_g,most_g,radius_m,speed_rad_s,motor_W
    CAL?           ISO date until which the rig's calibration holds
    STRE ON,rate_hz   STRE OFF      OK; samples on the stream link

State: READY STARTING RUNNING STOPPING FAULT NOREF. Errors: 1 unknown command, 2 arguments, 10 moving, 11 zero
mark lost, 12 beyond a limit, 13 door open, 14 not at speed. The edges of the trigger line are the passes over
the grating's zero mark, where the force along the stroke changes its sign.

Faults: door_open, lost_reference (the grating's zero mark), speed_not_reached (from the next RUN on), none.

A sample of the stream is that of a turntable (docs/bench.md), with the crank's angle and speed as the inner
ones and the grating's position in the reserved place.
"""

import math

import numpy as np

from dut_emulator.interfaces import BenchModelError, StandRefusal
from dut_emulator.stands.sinusoidal_overload_rig.live_rig import (
    ERR_NOT_RUNNING,
    FAULTS,
    RADIUS_M,
    LiveOverloadRig,
)

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
MAX_STREAM_RATE_HZ = 2000.0
_INSTANT_TOLERANCE_S = 1e-9
_WORDS = ("*IDN?", "RUN", "STOP", "AXIS", "ARM", "HALF?", "STAT?", "LIM?", "CAL?", "STRE")


class OverloadPort:
    """See the module and `StandModel`."""

    def __init__(self, rig: LiveOverloadRig, identification: str) -> None:
        self.rig = rig
        self._identification = identification
        self._rate_hz = 0.0
        self._started_s = 0.0
        self._taken = 0
        self._pending: list[bytes] = []

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        self._sample_to(now_s)
        word, _, rest = line.strip().partition(" ")
        arguments = [part.strip() for part in rest.split(",")] if rest.strip() else []
        try:
            return self._dispatch(word.upper(), arguments, now_s)
        except ValueError as error:
            return f"ERR {ERR_ARGUMENTS} {error}"

    def advance(self, to_s: float) -> bytes:
        """Stream samples of (last advance, to_s]."""
        self._sample_to(to_s)
        samples = b"".join(self._pending)
        self._pending.clear()
        return samples

    def next_event_s(self) -> float | None:
        """When the next sample is due."""
        return self._started_s + self._taken / self._rate_hz if self._rate_hz else None

    def inject(self, fault: str, now_s: float) -> None:
        """Raises BenchModelError for a fault that this rig cannot have."""
        if fault not in FAULTS:
            raise BenchModelError(
                f"an overload rig cannot have the fault '{fault}'; it can {', '.join(FAULTS)}"
            )
        self._sample_to(now_s)
        self.rig.inject(fault, now_s)

    def next_edge_s(self, after_s: float) -> float | None:
        """The trigger line's next edge; see `TriggerLine`."""
        return self.rig.next_mark_s(after_s)

    def _dispatch(self, word: str, arguments: list[str], now_s: float) -> str:
        rig = self.rig
        match word, len(arguments):
            case "*IDN?", 0:
                return self._identification
            case "RUN", 1:
                return _answer(rig.start(_number(arguments[0]), now_s))
            case "STOP", 0:
                return _answer(rig.stop(now_s))
            case "AXIS", 1:
                if arguments[0] not in ("1", "2", "3"):
                    raise ValueError("AXIS takes 1, 2 or 3")
                refusal = rig.mount(int(arguments[0]), now_s)
                return _refused(refusal) if refusal is not None else "OK"
            case "ARM", 0:
                return self._arm(now_s)
            case "HALF?", 0:
                half = rig.half_cycle(now_s)
                if isinstance(half, StandRefusal):
                    return _refused(half)
                figures = (half.duration_s, half.speed_change_m_s, half.squared_m2_s3)
                return ",".join([str(half.force), *(f"{figure:.9g}" for figure in figures)])
            case "STRE", 1 | 2:
                return self._stream(arguments, now_s)
            case (("STAT?" | "LIM?" | "CAL?"), 0):
                return self._told(word, now_s)
            case known, count if known in _WORDS:
                raise ValueError(f"{known} does not take {count} arguments")
            case _:
                return f"ERR {ERR_UNKNOWN} unknown command {word[:20]}"

    def _told(self, word: str, now_s: float) -> str:
        rig = self.rig
        if word == "CAL?":
            return rig.rig.identity.calibration_due
        if word == "LIM?":
            limits, drive = rig.rig.limits, rig.rig.drive
            figures = (limits.least_g, limits.most_g, RADIUS_M, limits.speed_rad_s, drive.motor_power_w)
            return ",".join(f"{figure:g}" for figure in figures)
        status = rig.status(now_s)
        seen = (
            *(status.overload_g, status.speed_rad_s, math.degrees(status.angle_rad)),
            *(status.position_m, status.temperature_c),
        )
        return ",".join([status.state, *(f"{figure:.7f}" for figure in seen)])

    def _arm(self, now_s: float) -> str:
        half = self.rig.state(now_s)
        edge_s = self.rig.next_mark_s(now_s) if half == "RUNNING" else None
        if edge_s is None:
            return f"ERR {ERR_NOT_RUNNING} not at speed: {half.lower()}"
        return _answer(edge_s - now_s)

    def _stream(self, arguments: list[str], now_s: float) -> str:
        match [arguments[0].upper(), *arguments[1:]]:
            case ["OFF"]:
                self._rate_hz = 0.0
            case ["ON", text]:
                rate_hz = _number(text)
                if not 0 < rate_hz <= MAX_STREAM_RATE_HZ:
                    raise ValueError(f"the stream's rate must lie between 0 and {MAX_STREAM_RATE_HZ:g} Hz")
                self._rate_hz, self._started_s, self._taken = rate_hz, now_s, 0
            case _:
                raise ValueError("STRE takes OFF, or ON and a rate")
        return "OK"

    def _sample_to(self, now_s: float) -> None:
        if not self._rate_hz:
            return
        ripe = math.floor((now_s - self._started_s + _INSTANT_TOLERANCE_S) * self._rate_hz) + 1
        if ripe > self._taken:
            times_s = self._started_s + np.arange(self._taken, ripe) / self._rate_hz
            self._pending.append(self.rig.stream_rows(times_s).astype("<f8").tobytes())
            self._taken = ripe


def _answer(answer: float | StandRefusal) -> str:
    return _refused(answer) if isinstance(answer, StandRefusal) else f"OK {answer:.9f}"


def _refused(refusal: StandRefusal) -> str:
    return f"ERR {refusal.code} {refusal.text}"


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{text[:20]}' is not a number")
    return value
