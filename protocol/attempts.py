"""What one attempt leaves behind: its record, whatever became of it."""

from typing import Literal

from pydantic import Field

from protocol.errors import Fault
from protocol.frozen_model import FrozenModel
from protocol.measurements import Measurement
from protocol.outcomes import Outcome
from protocol.plans import PlanReference

MAX_RECORD_BYTES = 1_000_000
"""A record larger than this is a mistake (raw data belong into a recording)."""


class UnitIdentity(FrozenModel):
    """A unit: serial, product and lot."""

    serial: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    product: str
    lot: str


class Lease(FrozenModel):
    """The right to run one operation on one unit at one socket, once.

    `fence` grows over the whole line: a station refuses a command, and the coordinator sets aside
    a record, whose fence is not the newest for that unit.
    """

    fence: int = Field(ge=1)
    attempt_id: str
    unit: UnitIdentity
    operation: str
    station: str
    socket: str
    plan: PlanReference


class RecordingReference(FrozenModel):
    """Raw data that stay at the station, named by their SHA-256."""

    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    path: str
    size_bytes: int = Field(ge=0)
    sample_count: int = Field(ge=0)
    description: str = ""


class StepRecord(FrozenModel):
    """One step as it went. Times are bench time since the sequence began."""

    step: str
    section: Literal["setup", "main", "teardown"]
    branch: int = 0
    outcome: Outcome
    started_bench_s: float
    ended_bench_s: float
    measurements: tuple[Measurement, ...] = ()
    fault: Fault = Fault.NONE
    message: str = ""


class AttemptRecord(FrozenModel):
    """The record of an attempt: written at the station, kept for ever by the coordinator.

    `attempt_id` is the idempotency key. `started_at_s`, `ended_at_s`: wall clock, seconds since
    1970 (UTC). `duration_bench_s`: bench time. `safe_state`: the unit was left powered off.
    """

    format: Literal["testloom-attempt/1"] = "testloom-attempt/1"
    attempt_id: str
    lease: Lease
    incarnation: int
    outcome: Outcome
    fault: Fault = Fault.NONE
    message: str = ""
    started_at_s: float
    ended_at_s: float
    duration_bench_s: float = 0.0
    steps: tuple[StepRecord, ...] = ()
    recordings: tuple[RecordingReference, ...] = ()
    safe_state: bool = False
    software_version: str


class SpooledRecord(FrozenModel):
    """A record with its place in the station's gap-free sequence."""

    sequence_number: int = Field(ge=1)
    record: AttemptRecord
