# pyright: strict
"""The command port and the sample stream of a single-axis rate table. One command a line.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `HOME` | `OK duration_s`: one slow turn over the reference mark; needed once before anything moves |
| `RATE rate[,acceleration]` | `OK duration_s`: of the ramp, then the rate is held; `RATE 0` is `LOCK` |
| `LOCK` | `OK duration_s`: to rest, then locked |
| `TILT axis` | `OK duration_s`: body axis 1, 2 or 3 (x, y, z) up, along the table's axis; only when locked |
| `STOP` | `OK`: everything to rest at the greatest acceleration |
| `STAT?` | `state,rate,commanded,angle,axis,temperature_c` (deg/s, deg/s, deg); axis 0: between two |
| `LIM?` | `least_rate,greatest_rate,greatest_acceleration` (deg/s, deg/s, deg/s²) |
| `CAL?` | ISO date until which its calibration holds |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, as a turntable's |

States: NOREF LOCKED RAMPING HOLDING SHORT TILTING SEEKING FAULT. SHORT: the drive holds less than it was
told. Errors are `ERR code text`: 1 unknown command, 2 arguments, 10 busy, 11 no reference, 12 limit, 13 door
open, 14 no mark, 15 argument, 16 not locked. Faults: `door_open`, `lost_reference`, `rate_not_reached`,
`none`.
"""

from typing import ClassVar

from dut_emulator.stands.command_port import CommandPort, Commands, SampleStream, number, ok
from dut_emulator.stands.rate_table_model import (
    FAULTS,
    MAX_ACCELERATION_DEG_S2,
    MAX_RATE_DEG_S,
    MIN_RATE_DEG_S,
    RateTableModel,
)
from protocol.stand_stream import STAND_SAMPLE_COLUMNS

MAX_STREAM_RATE_HZ = 2000.0


class RateTablePort(CommandPort):
    """One table behind its command port."""

    STAND = "a rate table"
    FAULTS = FAULTS
    COMMANDS: ClassVar[Commands] = {
        "HOME": (0,),
        "RATE": (1, 2),
        "LOCK": (0,),
        "TILT": (1,),
        "STOP": (0,),
        "STAT?": (0,),
        "LIM?": (0,),
    }

    def __init__(self, table: RateTableModel, identification: str, calibration_due: str) -> None:
        stream = SampleStream(table.encoder_samples, STAND_SAMPLE_COLUMNS, MAX_STREAM_RATE_HZ)
        super().__init__(identification, calibration_due, stream)
        self._table = table

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        match word:
            case "HOME":
                return ok(self._table.home(now_s))
            case "RATE":
                rate, acceleration = [*map(number, arguments), None][:2]
                assert rate is not None
                return ok(self._table.set_rate(rate, acceleration, now_s))
            case "LOCK":
                return ok(self._table.set_rate(0.0, None, now_s))
            case "TILT":
                axis = number(arguments[0])
                return ok(self._table.tilt(int(axis) if axis.is_integer() else 0, now_s))
            case "STOP":
                self._table.stop(now_s)
                return "OK"
            case "STAT?":
                now = self._table.status(now_s)
                figures = f"{now.rate_deg_s:.6f},{now.commanded_deg_s:.6f},{now.angle_deg:.6f}"
                return f"{now.state},{figures},{now.axis},{now.temperature_c:.6f}"
            case _:
                return f"{MIN_RATE_DEG_S:g},{MAX_RATE_DEG_S:g},{MAX_ACCELERATION_DEG_S2:g}"

    def _inject(self, fault: str, now_s: float) -> None:
        self._table.inject(fault, now_s)
