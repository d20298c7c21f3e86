"""From what a sequence left behind to the record that is kept for ever."""

from protocol.attempts import MAX_RECORD_BYTES, AttemptRecord, Lease
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from stations.sequencing.runner import SequenceResult


def record_of(
    lease: Lease,
    result: SequenceResult,
    *,
    incarnation: int,
    started_at_s: float,
    ended_at_s: float,
    software_version: str,
) -> AttemptRecord:
    """The record of a sequence. One that would be too large to keep says so and loses its steps."""
    record = AttemptRecord(
        attempt_id=lease.attempt_id,
        lease=lease,
        incarnation=incarnation,
        outcome=result.outcome,
        fault=result.fault,
        message=result.message,
        started_at_s=started_at_s,
        ended_at_s=max(started_at_s, ended_at_s),
        duration_bench_s=result.duration_bench_s,
        steps=result.steps,
        recordings=result.recordings,
        safe_state=result.safe_state,
        software_version=software_version,
    )
    size_bytes = len(record.model_dump_json().encode())
    if size_bytes <= MAX_RECORD_BYTES:
        return record
    message = f"the record of {size_bytes} bytes is too large to keep (at most {MAX_RECORD_BYTES})"
    reduced = {"outcome": Outcome.ERROR, "fault": Fault.PLAN, "message": message, "steps": ()}
    return record.model_copy(update=reduced)


def failed_result(error: TestloomError, *, safe_state: bool) -> SequenceResult:
    """The result of a sequence that could not begin (the unit was never powered), or that broke."""
    return SequenceResult(
        outcome=Outcome.ERROR,
        fault=error.fault if error.fault is not Fault.NONE else Fault.STATION,
        message=str(error),
        steps=(),
        recordings=(),
        duration_bench_s=0.0,
        safe_state=safe_state,
    )
