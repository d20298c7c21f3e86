"""Writes attempts into a spool until it is killed: what it prints has been committed."""

import sys
from pathlib import Path

from protocol.attempts import Lease, UnitIdentity
from protocol.plans import PlanReference
from stations.spool import Spool, aborted_record


def lease(fence: int) -> Lease:
    return Lease(
        fence=fence,
        attempt_id=f"a-{fence}",
        unit=UnitIdentity(serial=f"U-{fence}", product="gnc_module", lot="L1"),
        operation="functional",
        station="st-1",
        socket="1",
        plan=PlanReference(operation="functional", name="functional", version="1.0.0", sha256="0" * 64),
    )


def write(path: Path, first_fence: int) -> None:
    spool = Spool(path, "test/st-1")
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for fence in range(first_fence, first_fence + 10_000):
        spool.open_attempt(lease(fence), float(fence), 1)
        sys.stdout.write(f"opened {fence}\n")
        sys.stdout.flush()
        (attempt,) = spool.open_attempts()
        number = spool.add(aborted_record(attempt, ended_at_s=float(fence), message="", software_version="t"))
        sys.stdout.write(f"added {fence} {number}\n")
        sys.stdout.flush()
        if fence % 3 == 0:
            sys.stdout.write(f"dropping {fence}\n")
            sys.stdout.flush()
            spool.drop([f"a-{fence}"])


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]))
