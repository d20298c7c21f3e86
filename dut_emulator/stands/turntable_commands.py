# pyright: strict
"""The command port and the sample stream of turntables. One command a line.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `HOME` | `OK`: finds the reference marks and goes to zero angles |
| `MOVE outer,middle,inner` | `OK duration_s`: at rest after that time (deg) |
| `ROT axis,angle,duration_s,ramp_s` | `OK duration_s`: a trapezoid of rate with equal ramps (deg) |
| `SWING axis,amplitude,rate,cycles` | `OK duration_s`: a sine of this amplitude and peak rate \
(deg, deg/s), whole periods between the present angle and two amplitudes further |
| `STOP` | `OK`: to rest at the acceleration limit |
| `STAT?` | `state,outer,middle,inner,rate_outer,rate_middle,rate_inner,temperature_c` (deg, deg/s) |
| `LIM?` | `rate_outer,rate_middle,rate_inner,acceleration_outer,acceleration_middle,acceleration_inner` \
(deg/s, deg/s²); 0: this axis has no drive |
| `CAL?` | ISO date until which its calibration holds |
| `TEMP target,ramp` | `OK duration_s` (°C, °C/min); chambers only |
| `TEMP?` | `air,set_point` (°C), the air at the probe; chambers only |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, up to 2000 Hz |

States: READY MOVING FAULT NOREF. Errors are `ERR code text`: 1 unknown command, 2 arguments, 10 busy, 11 no
reference, 12 limit, 13 door open, 14 no mark, 15 argument. Faults: `door_open`, `lost_reference` (until
`HOME`), `rate_not_reached` (a `ROT` is answered as ever, but runs at nine tenths of its rate and ends short
of its angle), `none`.

Laboratory frame: x east, y north, z up (turned about z by `Site.heading_deg`). At zero angles the body axes
are the laboratory's. `C_body_from_lab = Rx(inner) · Ry(middle) · Rz(outer)`, each R the passive rotation
(coordinates turn, `Rz(a) = [[cos a, sin a, 0], [−sin a, cos a, 0], [0, 0, 1]]`). So the outer axis is
vertical, the inner axis is the body's x, and body x points up at middle = −90°. All turntables have three
angles; an axis without a drive stays at its home.

Stream sample (little endian, 15 × f64, no framing): time_s, rate_x rate_y rate_z (body rate relative to the
laboratory, rad/s), acc_x acc_y acc_z (specific force at the stand's centre, m/s²), angles outer middle
inner (rad), rates outer middle inner (rad/s), temperature °C, reserved. Rates and specific force are
resolved in the unit's nominal axes and are the stand's own reading: encoder resolution and wobble included.

Omitted: continuous rate mode, sweeps, the axes' zero settings.
"""

from typing import ClassVar, Protocol

from dut_emulator.interfaces import EmulatedStand, StandRefusal
from dut_emulator.stands.command_port import CommandPort, Commands, SampleStream, accepted, number, ok
from protocol.stand_stream import STAND_SAMPLE_COLUMNS

MAX_STREAM_RATE_HZ = 2000.0


class Turntable(EmulatedStand, Protocol):
    """What the port asks of a stand."""

    def swing(
        self, axis: str, amplitude_deg: float, peak_rate_deg_s: float, cycles: float, now_s: float
    ) -> float | StandRefusal:
        """Whole periods of a sine on one axis."""
        ...


class Chamber(Protocol):
    """What the port asks of a stand with a chamber."""

    def set_temperature(self, target_c: float, ramp_c_per_min: float, now_s: float) -> float | StandRefusal:
        """Begin a ramp of the air; the time that it takes in s."""
        ...

    def temperatures_c(self, now_s: float) -> tuple[float, float]:
        """Of the air at the probe, and the set point."""
        ...


class TurntablePort(CommandPort):
    """One turntable behind its command port. `chamber`: None knows no `TEMP`."""

    STAND = "a turntable"
    FAULTS = ("none", "door_open", "lost_reference", "rate_not_reached")
    COMMANDS: ClassVar[Commands] = {
        "HOME": (0,),
        "MOVE": (3,),
        "ROT": (4,),
        "SWING": (4,),
        "STOP": (0,),
        "STAT?": (0,),
        "LIM?": (0,),
    }
    CHAMBER_COMMANDS: ClassVar[Commands] = {"TEMP": (2,), "TEMP?": (0,)}

    def __init__(
        self, stand: Turntable, identification: str, calibration_due: str, chamber: Chamber | None = None
    ) -> None:
        stream = SampleStream(stand.encoder_samples, STAND_SAMPLE_COLUMNS, MAX_STREAM_RATE_HZ)
        super().__init__(identification, calibration_due, stream)
        self._stand, self._chamber = stand, chamber

    def _commands(self) -> Commands:
        return self.COMMANDS if self._chamber is None else {**self.COMMANDS, **self.CHAMBER_COMMANDS}

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        stand = self._stand
        match word:
            case "HOME":
                accepted(stand.home(now_s))
                return "OK"
            case "MOVE":
                outer, middle, inner = map(number, arguments)
                return ok(stand.move((outer, middle, inner), now_s))
            case "ROT":
                angle_deg, duration_s, ramp_s = map(number, arguments[1:])
                return ok(stand.rotate(arguments[0].lower(), angle_deg, duration_s, ramp_s, now_s))
            case "SWING":
                amplitude_deg, rate_deg_s, cycles = map(number, arguments[1:])
                return ok(stand.swing(arguments[0].lower(), amplitude_deg, rate_deg_s, cycles, now_s))
            case "STOP":
                stand.stop(now_s)
                return "OK"
            case "STAT?":
                status = stand.status(now_s)
                figures = (*status.angles_deg, *status.rates_deg_s, status.temperature_c)
                return ",".join([status.state, *(f"{figure:.6f}" for figure in figures)])
            case "LIM?":
                return ",".join(f"{limit:g}" for limit in stand.limits())
            case _:
                assert self._chamber is not None
                return self._temperature(self._chamber, arguments, now_s)

    @staticmethod
    def _temperature(chamber: Chamber, arguments: list[str], now_s: float) -> str:
        if not arguments:
            air_c, target_c = chamber.temperatures_c(now_s)
            return f"{air_c:.2f},{target_c:g}"
        target_c, ramp_c_per_min = map(number, arguments)
        return ok(chamber.set_temperature(target_c, ramp_c_per_min, now_s))

    def _inject(self, fault: str, now_s: float) -> None:
        self._stand.inject(fault, now_s)
