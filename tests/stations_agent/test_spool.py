"""The spool loses nothing: under SIGKILL, on a full disk, over a restart, with a damaged file."""

import random
import subprocess
import sys
from pathlib import Path

import pytest

from protocol.attempts import AttemptRecord, Lease, UnitIdentity
from protocol.errors import Fault
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from stations.spool import (
    MAX_REMEMBERED_FENCES,
    OpenAttempt,
    Spool,
    SpoolError,
    SpoolUnwritableError,
    aborted_record,
    close_interrupted,
    leases_ended,
    records_made,
    unacknowledged_count,
)

OWNER = "test/st-1"


def lease(fence: int, message: str = "") -> Lease:
    return Lease(
        fence=fence,
        attempt_id=f"a-{fence}{message}",
        unit=UnitIdentity(serial=f"U-{fence}", product="gnc_module", lot="L1"),
        operation="functional",
        station="st-1",
        socket="1",
        plan=PlanReference(operation="functional", name="functional", version="1.0.0", sha256="0" * 64),
    )


def record(fence: int, message: str = "") -> AttemptRecord:
    return aborted_record(
        OpenAttempt(lease(fence), 1.0, 1), ended_at_s=2.0, message=message, software_version="t"
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "spool.sqlite"


def test_numbers_stay_gap_free_over_deletion_and_restart(path: Path) -> None:
    for opening in range(3):
        spool = Spool(path, OWNER)
        numbers = [spool.add(record(10 * opening + fence)) for fence in (1, 2)]
        assert numbers == [2 * opening + 1, 2 * opening + 2]
        spool.drop([f"a-{10 * opening + fence}" for fence in (1, 2)])
        assert spool.unacknowledged() == {}
        assert spool.next_number() == 2 * opening + 3
        spool.close()


def test_everything_done_twice_counts_once(path: Path) -> None:
    spool = Spool(path, OWNER)
    for _ in range(2):
        spool.open_attempt(lease(1), 5.0, 7)
    assert spool.open_attempts() == (OpenAttempt(lease(1), 5.0, 7),)
    assert spool.add(record(1)) == spool.add(record(1)) == 1
    assert spool.open_attempts() == ()
    assert [kept.record for kept in spool.records([1, 99])] == [record(1)]
    spool.drop(["a-1", "a-1", "never heard of"])
    spool.drop(["a-1"])
    assert spool.records([1]) == ()
    spool.close()


def test_fences_are_remembered_within_their_bound(path: Path) -> None:
    spool = Spool(path, OWNER)
    for fence in (3, 5, MAX_REMEMBERED_FENCES + 3):
        spool.open_attempt(lease(fence), 0.0, 1)
    assert [remembered.fence for remembered in spool.fences()] == [5, MAX_REMEMBERED_FENCES + 3]
    spool.close()


def test_an_agent_that_died_leaves_an_aborted_record(path: Path) -> None:
    spool = Spool(path, OWNER)
    spool.add(record(1))
    spool.open_attempt(lease(2), 5.0, 7)
    spool.close()

    spool = Spool(path, OWNER)
    for expected in (1, 0):  # the second look finds nothing left to close
        closed = close_interrupted(spool, ended_at_s=9.0, software_version="t")
        assert len(closed) == expected
    (kept,) = spool.records([2])
    assert (kept.record.outcome, kept.record.fault) == (Outcome.ABORTED, Fault.STATION)
    assert kept.record.incarnation == 7
    assert "the agent stopped while" in kept.record.message
    assert not kept.record.safe_state
    spool.close()


def test_a_full_disk_keeps_what_is_there_and_says_so(path: Path) -> None:
    spool = Spool(path, OWNER, max_pages=16)
    added = 1
    while spool.add(record(added, "x" * 2000)) < 4:
        added += 1
    with pytest.raises(SpoolUnwritableError, match="disk is full") as caught:
        spool.add(record(added + 1, "x" * 60_000))
    assert caught.value.fault is Fault.STATION
    kept = spool.unacknowledged()
    assert list(kept) == [1, 2, 3, 4]
    assert spool.next_number() == 5
    with pytest.raises(SpoolUnwritableError):
        spool.open_attempt(lease(99, "x" * 60_000), 0.0, 1)
    assert spool.open_attempts() == ()

    spool.drop(list(kept.values()))  # the coordinator came back: there is room, and no gap
    assert spool.add(record(added + 1, "x" * 2000)) == 5
    spool.close()


@pytest.mark.parametrize("damage", ["head", "middle"])
def test_a_damaged_file_is_named_and_left_alone(path: Path, damage: str) -> None:
    spool = Spool(path, OWNER)
    for fence in range(1, 40):
        spool.add(record(fence, "x" * 1000))
    spool.close()
    content = bytearray(path.read_bytes())
    start = 0 if damage == "head" else 4096
    content[start : start + 6000] = b"\xa5" * 6000
    path.write_bytes(content)

    with pytest.raises(SpoolError, match="damaged") as caught:
        Spool(path, OWNER)
    assert str(path) in caught.value.where
    assert "aside" in caught.value.remedy
    assert path.read_bytes() == content


def test_a_spool_has_one_owner_at_a_time(path: Path) -> None:
    first = Spool(path, OWNER)
    with pytest.raises(SpoolError, match="Another agent"):
        Spool(path, OWNER)
    assert (unacknowledged_count(path), records_made(path)) == (0, 0)  # looking is free
    assert [first.add(record(fence)) for fence in (1, 2)] == [1, 2]
    first.drop(["a-1"])
    assert (unacknowledged_count(path), records_made(path)) == (1, 2)
    first.close()
    assert unacknowledged_count(path.with_name("none")) == 0
    with pytest.raises(SpoolError, match="belongs to 'test/st-1'"):
        Spool(path, "test/st-2")
    with pytest.raises(SpoolUnwritableError, match="cannot be opened"):
        Spool(path / "not a folder" / "spool.sqlite", OWNER)


def test_sigkill_at_any_moment_loses_no_committed_record(path: Path) -> None:
    """The writer says what it has committed; whatever it said must be there, under gap-free numbers."""
    moments = random.Random(5)
    numbers: dict[int, int] = {}
    next_fence = 1
    for _ in range(6):
        said = _kill_a_writer(path, next_fence, after_lines=moments.randrange(1, 60))
        spool = Spool(path, OWNER)
        interrupted = close_interrupted(spool, ended_at_s=0.0, software_version="t")
        kept = {int(attempt_id[2:]): number for number, attempt_id in spool.unacknowledged().items()}
        added = {fence: number for word, fence, number in said if word == "added"}
        dropping = {fence for word, fence, _ in said if word == "dropping"}
        opened = {fence for word, fence, _ in said if word == "opened"}
        assert added.items() - kept.items() <= {(fence, added[fence]) for fence in dropping}
        assert len(interrupted) <= 1
        assert opened <= kept.keys() | dropping
        numbers |= added | kept
        next_fence = max(numbers, default=0) + 1
        assert sorted(numbers.values()) == list(range(1, spool.next_number()))
        spool.close()


def _kill_a_writer(path: Path, first_fence: int, *, after_lines: int) -> list[tuple[str, int, int]]:
    script = Path(__file__).with_name("spool_writer.py")
    process = subprocess.Popen(
        [sys.executable, str(script), str(path), str(first_fence)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        env={"PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert process.stdout is not None
    lines: list[str] = []
    with process:
        for line in process.stdout:
            lines.append(line)
            if len(lines) == after_lines + 1:
                process.kill()
    assert lines[0] == "ready\n"
    said = [line.split() for line in lines[1:] if line.endswith("\n")]
    return [(words[0], int(words[1]), int(words[2]) if len(words) > 2 else 0) for words in said]


def test_somebody_who_looks_sees_what_is_still_to_come_and_what_has_ended(path: Path) -> None:
    assert (unacknowledged_count(path), leases_ended(path)) == (0, frozenset())  # no spool yet
    spool = Spool(path, OWNER)
    for fence in (1, 2, 3):
        spool.open_attempt(lease(fence), 0.0, 1)
    for fence in (1, 2):
        spool.add(record(fence))
    spool.drop(["a-1"])
    assert unacknowledged_count(path) == 2  # record 2, and the record that lease 3 will leave
    assert leases_ended(path) == {1, 2}
    spool.close()


def test_incarnations_grow_though_the_clock_is_set_back_or_the_disk_is_full(path: Path) -> None:
    given = []
    for now_ns in (1_000, 400, 5_000, 5_000):
        spool = Spool(path, OWNER)
        given.append(spool.next_incarnation(now_ns))
        spool.close()
    assert given == [1_000, 1_001, 5_000, 5_001]
    read_only = Spool(path, OWNER)
    read_only._database.execute("PRAGMA query_only = ON")  # no commit succeeds any more
    assert read_only.next_incarnation(7_000) == 7_000
    read_only.close()
