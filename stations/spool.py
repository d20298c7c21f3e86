"""The station's spool: a result exists once it is committed here.

SQLite (WAL, synchronous=FULL) in one file; one agent at a time holds it, by a lock on a file beside
it that dies with the process. Anybody may look. Three things are kept:

- the *trace* of every sequence from before its start until its record is there. A trace that is
  found when the spool is opened belongs to an agent that died, and is closed as an ABORTED record;
- the *records*, under gap-free numbers, until the coordinator has acknowledged them;
- the newest *fences*, so that a command that arrives twice runs once, also across a restart.

A damaged file is moved aside, never deleted, and never silently replaced.
"""

import fcntl
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from protocol.attempts import MAX_RECORD_BYTES, AttemptRecord, Lease, SpooledRecord
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from stations.agent.fences import FENCE_WINDOW

FORMAT_VERSION = 1
MAX_REMEMBERED_FENCES = FENCE_WINDOW
"""Those further back are stale by the agent's own rule."""
BUSY_TIMEOUT_S = 2.0
"""Somebody who only looks may hold a commit up this long."""

_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS spool"
    " (one INTEGER PRIMARY KEY CHECK (one = 1), version INTEGER NOT NULL, owner TEXT NOT NULL,"
    " next_number INTEGER NOT NULL)",
    "CREATE TABLE IF NOT EXISTS attempts_open"
    " (attempt_id TEXT PRIMARY KEY, lease TEXT NOT NULL, started_at_s REAL NOT NULL,"
    " incarnation INTEGER NOT NULL)",
    "CREATE TABLE IF NOT EXISTS records"
    " (sequence_number INTEGER PRIMARY KEY, attempt_id TEXT NOT NULL UNIQUE, record TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS incarnations"
    " (one INTEGER PRIMARY KEY CHECK (one = 1), newest INTEGER NOT NULL)",
    "CREATE TABLE IF NOT EXISTS fences"
    " (fence INTEGER PRIMARY KEY, socket TEXT NOT NULL, serial TEXT NOT NULL)",
)


class SpoolError(TestloomError):
    """The spool cannot be used: damaged, of another station, or held by another agent."""


class SpoolUnwritableError(SpoolError):
    """The spool cannot take this now (a full disk, most often): keep it, and try again."""


@dataclass(frozen=True)
class OpenAttempt:
    """The trace of a sequence that has started and has no record yet. `started_at_s`: wall clock."""

    lease: Lease
    started_at_s: float
    incarnation: int


@dataclass(frozen=True)
class RememberedFence:
    """A lease that was started here once."""

    fence: int
    socket: str
    serial: str


class Spool:
    """One station's spool. To be used from the thread that opened it.

    Args:
        path: the database file; made if it is not there.
        owner: whose numbers these are, e.g. 'demo/functional-1'.
        max_pages: upper bound of the file in pages of 4 KiB; None: the disk is the bound.

    Raises:
        SpoolError: the file is damaged, belongs to another station or is in use.
        SpoolUnwritableError: there is no room for it, or no permission.
    """

    def __init__(self, path: Path, owner: str, *, max_pages: int | None = None) -> None:
        self._path = path
        self._owner = owner
        self._lock = _locked(path)
        try:
            with self._explained():
                self._database = sqlite3.connect(path, timeout=BUSY_TIMEOUT_S, isolation_level=None)
                self._prepare(max_pages)
        except SpoolError:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        if hasattr(self, "_database"):
            self._database.close()
        os.close(self._lock)

    def open_attempt(self, lease: Lease, started_at_s: float, incarnation: int) -> None:
        """Leave the trace of a sequence before it starts; doing so twice changes nothing.

        Raises:
            SpoolUnwritableError: the trace is not there, so the sequence must not start.
        """
        with self._transaction():
            self._database.execute(
                "INSERT OR IGNORE INTO attempts_open VALUES (?, ?, ?, ?)",
                (lease.attempt_id, lease.model_dump_json(), started_at_s, incarnation),
            )
            self._database.execute(
                "INSERT OR REPLACE INTO fences VALUES (?, ?, ?)",
                (lease.fence, lease.socket, lease.unit.serial),
            )
            self._database.execute(
                "DELETE FROM fences WHERE fence <= ?", (lease.fence - MAX_REMEMBERED_FENCES,)
            )

    def open_attempts(self) -> tuple[OpenAttempt, ...]:
        """Sequences that have started and have no record."""
        with self._explained():
            rows = self._database.execute(
                "SELECT lease, started_at_s, incarnation FROM attempts_open ORDER BY rowid"
            ).fetchall()
        return tuple(OpenAttempt(Lease.model_validate_json(row[0]), row[1], row[2]) for row in rows)

    def add(self, record: AttemptRecord) -> int:
        """Keep a record and take its trace away, in one commit. A record that is here keeps its number.

        Returns:
            The record's sequence number.

        Raises:
            SpoolError: the record is larger than `MAX_RECORD_BYTES`.
            SpoolUnwritableError: the record is not here; its trace still is.
        """
        text = record.model_dump_json()
        if len(text) > MAX_RECORD_BYTES:
            raise SpoolError(
                f"The record of attempt {record.attempt_id} has {len(text)} bytes "
                f"(at most {MAX_RECORD_BYTES}).",
                where=str(self._path),
                fault=Fault.PLAN,
                remedy="keep raw data in a recording, and measurements in the record.",
            )
        with self._transaction():
            known = self._database.execute(
                "SELECT sequence_number FROM records WHERE attempt_id = ?", (record.attempt_id,)
            ).fetchone()
            number: int = known[0] if known else self._insert(record.attempt_id, text)
            self._database.execute("DELETE FROM attempts_open WHERE attempt_id = ?", (record.attempt_id,))
        return number

    def unacknowledged(self) -> dict[int, str]:
        """Sequence number → attempt id of every record kept, in the order of the numbers."""
        with self._explained():
            rows = self._database.execute(
                "SELECT sequence_number, attempt_id FROM records ORDER BY sequence_number"
            ).fetchall()
        return dict(rows)

    def records(self, numbers: Iterable[int]) -> tuple[SpooledRecord, ...]:
        """The records with these numbers, as far as they are here, in the order asked for."""
        found: list[SpooledRecord] = []
        with self._explained():
            for number in numbers:
                row = self._database.execute(
                    "SELECT record FROM records WHERE sequence_number = ?", (number,)
                ).fetchone()
                if row:
                    record = AttemptRecord.model_validate_json(row[0])
                    found.append(SpooledRecord(sequence_number=number, record=record))
        return tuple(found)

    def drop(self, attempt_ids: Iterable[str]) -> None:
        """Forget records that the coordinator has durably; unknown ids change nothing.

        Raises:
            SpoolUnwritableError: they are all still here; they may be submitted again.
        """
        with self._transaction():
            self._database.executemany(
                "DELETE FROM records WHERE attempt_id = ?", ((attempt_id,) for attempt_id in attempt_ids)
            )

    def next_incarnation(self, now_ns: int) -> int:
        """The incarnation of an agent that starts now: larger than every one before it, also when the
        wall clock was set back, so that it is not taken for the older of two."""
        with self._explained():
            row = self._database.execute("SELECT newest FROM incarnations").fetchone()
        incarnation = max(now_ns, row[0] + 1 if row else 0)
        with suppress(SpoolUnwritableError), self._transaction():  # a full disk keeps no agent from starting
            self._database.execute("INSERT OR REPLACE INTO incarnations VALUES (1, ?)", (incarnation,))
        return incarnation

    def next_number(self) -> int:
        """The number that the next record will get."""
        with self._explained():
            return int(self._database.execute("SELECT next_number FROM spool").fetchone()[0])

    def fences(self) -> tuple[RememberedFence, ...]:
        """The newest leases that were started here, oldest first."""
        with self._explained():
            rows = self._database.execute(
                "SELECT fence, socket, serial FROM fences ORDER BY fence"
            ).fetchall()
        return tuple(RememberedFence(*row) for row in rows)

    def _insert(self, attempt_id: str, text: str) -> int:
        number: int = self._database.execute("SELECT next_number FROM spool").fetchone()[0]
        self._database.execute("INSERT INTO records VALUES (?, ?, ?)", (number, attempt_id, text))
        self._database.execute("UPDATE spool SET next_number = ?", (number + 1,))
        return number

    def _prepare(self, max_pages: int | None) -> None:
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = FULL")
        if max_pages is not None:
            self._database.execute(f"PRAGMA max_page_count = {max_pages}")
        damage = self._database.execute("PRAGMA quick_check(1)").fetchone()[0]
        if damage != "ok":
            raise self._damaged(damage)
        with self._transaction():
            for statement in _SCHEMA:
                self._database.execute(statement)
            self._database.execute(
                "INSERT OR IGNORE INTO spool VALUES (1, ?, ?, 1)", (FORMAT_VERSION, self._owner)
            )
            version, owner = self._database.execute("SELECT version, owner FROM spool").fetchone()
        if (version, owner) != (FORMAT_VERSION, self._owner):
            raise SpoolError(
                f"This spool belongs to '{owner}' (format {version}), not to '{self._owner}' "
                f"(format {FORMAT_VERSION}).",
                where=str(self._path),
                fault=Fault.OPERATOR,
                remedy="give each station a spool folder of its own.",
            )

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._explained():
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:  # a full disk may have rolled back by itself
                    self._database.execute("ROLLBACK")
                raise

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.DatabaseError as error:
            raise self._explanation(error) from error

    def _explanation(self, error: sqlite3.DatabaseError) -> SpoolError:
        primary_code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if primary_code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            return self._damaged(str(error))
        if primary_code == sqlite3.SQLITE_FULL:
            what, remedy = "The spool cannot be written: the disk is full", "free space on this disk"
        else:
            what, remedy = "The spool cannot be written", "check the folder, its permissions and its disk"
        return SpoolUnwritableError(
            f"{what} ({error}).",
            where=str(self._path),
            fault=Fault.STATION,
            remedy=f"{remedy}; the agent keeps its records and tries again.",
        )

    def _damaged(self, how: str) -> SpoolError:
        return SpoolError(
            f"The spool's database is damaged ({how}).",
            where=str(self._path),
            fault=Fault.STATION,
            remedy=f"move {self._path.name} and {self._path.name}-wal aside (do not delete them: they "
            "may hold results that 'sqlite3 FILE .recover' can save), then start the agent again.",
        )


def unacknowledged_count(path: Path) -> int:
    """Records in a spool that the coordinator has not acknowledged, and attempts that are still to
    leave theirs, for somebody who only looks.

    Raises:
        SpoolError: the file is there and cannot be read.
    """
    return _look(path, "SELECT (SELECT count(*) FROM records) + (SELECT count(*) FROM attempts_open)")


def records_made(path: Path) -> int:
    """Records that a station has ever put into its spool; 0 if there is no spool. Raises as above."""
    return _look(path, "SELECT max(next_number) - 1 FROM spool")


def leases_ended(path: Path) -> frozenset[int]:
    """Fences of the newest leases that a station began and has a record of; each has to be kept
    somewhere. A lease whose trace is still open is not among them: its agent closes it when it starts
    again. Raises as above."""
    rows = _rows(
        path,
        "SELECT fence FROM fences WHERE fence NOT IN"
        " (SELECT json_extract(lease, '$.fence') FROM attempts_open)",
    )
    return frozenset(row[0] for row in rows)


def _look(path: Path, question: str) -> int:
    rows = _rows(path, question)
    return int(rows[0][0] or 0) if rows else 0


def _rows(path: Path, question: str) -> list[tuple[int, ...]]:
    """The answer of a spool; none if there is no spool."""
    if not path.exists():
        return []
    try:
        with closing(sqlite3.connect(path, timeout=BUSY_TIMEOUT_S)) as database:
            database.execute("PRAGMA query_only = ON")
            return database.execute(question).fetchall()
    except sqlite3.DatabaseError as error:
        if "no such table" in str(error):  # its agent is just making it
            return []
        raise SpoolError(
            f"The spool cannot be read ({error}).",
            where=str(path),
            fault=Fault.STATION,
            remedy="start its agent: it says what is wrong with the file.",
        ) from error


def _locked(path: Path) -> int:
    """The descriptor of the lock beside the spool, held."""
    lock_path = path.with_name(path.name + ".lock")
    try:
        descriptor = os.open(lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise SpoolUnwritableError(
            f"The spool cannot be opened ({error.strerror}).",
            where=str(lock_path),
            fault=Fault.STATION,
            remedy="check the folder, its permissions and its disk.",
        ) from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise SpoolError(
            "Another agent uses this spool.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="stop the other agent, or give this one a spool of its own.",
        ) from None
    return descriptor


def aborted_record(
    attempt: OpenAttempt, *, ended_at_s: float, message: str, software_version: str
) -> AttemptRecord:
    """The record of a sequence whose agent stopped: nobody saw its end, so the safe state is not claimed."""
    return AttemptRecord(
        attempt_id=attempt.lease.attempt_id,
        lease=attempt.lease,
        incarnation=attempt.incarnation,
        outcome=Outcome.ABORTED,
        fault=Fault.STATION,
        message=message,
        started_at_s=attempt.started_at_s,
        ended_at_s=max(ended_at_s, attempt.started_at_s),
        software_version=software_version,
    )


def close_interrupted(spool: Spool, *, ended_at_s: float, software_version: str) -> tuple[AttemptRecord, ...]:
    """Close every trace that an agent left behind when it died, as an ABORTED record of the station.

    Raises:
        SpoolUnwritableError: the disk is full; what was not closed is closed at the next start.
    """
    records = tuple(
        aborted_record(
            attempt,
            ended_at_s=ended_at_s,
            message="the agent stopped while the sequence was running",
            software_version=software_version,
        )
        for attempt in spool.open_attempts()
    )
    for record in records:
        spool.add(record)
    return records
