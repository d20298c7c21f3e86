"""The journal and the results of one line.

A batch, the outcome of many events, is one transaction: facts, records with their measurements and
recordings, units, alarms. What `commit` returned from is durable; if it raised, nothing of the
batch is there. Each journal line carries a digest chained over all lines before it, so a line that
was lost, changed or put in by hand is found when the journal is read.

Journal lines are numbered by the coordinator, not by the database: a second coordinator on the same
journal fails on its first commit.
"""

import hashlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError
from sqlalchemy import Connection, func, insert, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import DBAPIError

from coordinator.store import schema, tables
from coordinator.store.schema import StoreConflictError, StoreDamagedError
from protocol.attempts import AttemptRecord
from protocol.coordinator_commands import KeepRecord, KeepUnit
from protocol.coordinator_events import FACT, JOURNAL_FORMAT, Fact
from protocol.errors import Fault
from protocol.frozen_model import first_problem
from protocol.line_views import Alarm, AttemptView
from protocol.measurements import Measurement

READ_BATCH = 2_000
MAX_ATTEMPTS_SHOWN = 500
_FIRST_DIGEST = "0" * 32


@dataclass(slots=True)
class Batch:
    """What belongs into one transaction."""

    facts: list[Fact] = field(default_factory=list[Fact])
    records: list[tuple[AttemptRecord, KeepRecord]] = field(
        default_factory=list[tuple[AttemptRecord, KeepRecord]]
    )
    units: dict[str, KeepUnit] = field(default_factory=dict[str, KeepUnit])
    alarms: list[Alarm] = field(default_factory=list[Alarm])

    def __bool__(self) -> bool:
        return bool(self.facts or self.records or self.units or self.alarms)


class LineStore:
    """One line's database. Not thread-safe: the core's thread owns it."""

    def __init__(self, url: str, line: str) -> None:
        """Open, migrate, and see that the database is this line's.

        Raises:
            StoreUnavailableError, StoreDamagedError, StoreConflictError, TestloomError: see schema.py.
        """
        self._engine = schema.open_engine(url)
        self._line = line
        self._sequence = 0
        self._digest = _FIRST_DIGEST
        try:
            schema.migrate(self._engine)
            self._claim()
        except BaseException:
            self._engine.dispose()
            raise

    @property
    def place(self) -> str:
        """Where the database is, without its password."""
        return schema.place_of(self._engine)

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def facts(self) -> Iterator[Fact]:
        """The journal from its beginning, checked; must be read to its end before `commit`.

        Raises:
            StoreDamagedError: a line is missing, changed, or cannot be read.
            StoreUnavailableError: the database cannot be read.
        """
        self._sequence, self._digest = 0, _FIRST_DIGEST
        query = select(tables.JOURNAL).order_by(tables.JOURNAL.c.sequence)
        try:
            with (
                self._engine.connect() as connection,
                closing(connection.execution_options(yield_per=READ_BATCH).execute(query)) as rows,
            ):
                for row in rows:
                    yield self._checked(row.sequence, row.fact, row.digest)
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None

    def commit(self, batch: Batch) -> None:
        """Write a batch, durably.

        Raises:
            StoreUnavailableError: nothing was written; try again later.
            StoreConflictError: another coordinator writes here; nothing was written.
            StoreDamagedError: the database is damaged.
        """
        if not batch:
            return
        sequence, digest = self._sequence, self._digest
        lines: list[dict[str, Any]] = []
        for fact in batch.facts:
            text = fact.model_dump_json()
            sequence += 1
            digest = _chained(digest, text)
            lines.append(
                {"sequence": sequence, "at_s": fact.at_s, "kind": fact.kind, "fact": text, "digest": digest}
            )
        try:
            with self._engine.begin() as connection:
                if lines:
                    connection.execute(insert(tables.JOURNAL), lines)
                _keep_records(connection, batch.records)
                _keep_units(connection, list(batch.units.values()))
                if batch.alarms:
                    connection.execute(insert(tables.ALARMS), [_alarm_row(alarm) for alarm in batch.alarms])
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None
        self._sequence, self._digest = sequence, digest

    def check_sole_writer(self) -> None:
        """See that the journal ends where this coordinator left it.

        Raises:
            StoreConflictError: another coordinator has written to it.
            StoreUnavailableError: the database cannot be read.
        """
        try:
            with self._engine.connect() as connection:
                last = connection.execute(select(func.max(tables.JOURNAL.c.sequence))).scalar() or 0
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None
        if last != self._sequence:
            raise schema.written_by_another(self._engine)

    def attempts_of(self, serial: str) -> tuple[AttemptView, ...]:
        """A unit's attempts as kept, in the order in which they came.

        Raises:
            StoreUnavailableError: the database cannot be read.
            StoreDamagedError: a record is not what was written; the line can go on without this view.
        """
        attempts = tables.ATTEMPTS
        query = (
            select(attempts.c.record, attempts.c.set_aside, attempts.c.received_at_s)
            .where(attempts.c.serial == serial)
            .order_by(attempts.c.received_at_s, attempts.c.fence)
            .limit(MAX_ATTEMPTS_SHOWN)
        )
        try:
            with self._engine.connect() as connection:
                rows = connection.execute(query).all()
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None
        try:
            return tuple(
                AttemptView(
                    record=AttemptRecord.model_validate_json(row.record),
                    set_aside=bool(row.set_aside),
                    received_at_s=row.received_at_s,
                )
                for row in rows
            )
        except ValidationError as error:
            raise self._damaged(
                "attempts", f"a record of {serial} cannot be read ({first_problem(error)})"
            ) from None

    def recent_alarms(self, limit: int) -> tuple[Alarm, ...]:
        """The last alarms, oldest first.

        Raises:
            StoreUnavailableError: the database cannot be read.
        """
        query = select(tables.ALARMS.c.view).order_by(tables.ALARMS.c.number.desc()).limit(limit)
        try:
            with self._engine.connect() as connection:
                views = connection.execute(query).scalars().all()
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None
        return tuple(Alarm.model_validate_json(view) for view in reversed(views))

    def _claim(self) -> None:
        """Write the line's name into a new database, compare it with an old one's."""
        try:
            with self._engine.begin() as connection:
                row = connection.execute(select(tables.LINE)).one_or_none()
                if row is None:
                    connection.execute(
                        insert(tables.LINE), {"name": self._line, "journal_format": JOURNAL_FORMAT}
                    )
                    return
        except DBAPIError as error:
            raise schema.store_error(error, self._engine) from None
        if row.name != self._line:
            raise StoreConflictError(
                f"The database belongs to line '{row.name}', not to '{self._line}'.",
                where=self.place,
                fault=Fault.OPERATOR,
                remedy="give each line its own database, or correct --line.",
            )
        if row.journal_format != JOURNAL_FORMAT:
            raise StoreConflictError(
                f"The journal has format {row.journal_format}, this version reads {JOURNAL_FORMAT}.",
                where=self.place,
                fault=Fault.OPERATOR,
                remedy="use the version of Testloom that wrote it, or a new database.",
            )

    def _checked(self, sequence: int, text: str, digest: str) -> Fact:
        if sequence != self._sequence + 1:
            raise self._damaged("journal", f"lines {self._sequence + 1} to {sequence - 1} are missing")
        if _chained(self._digest, text) != digest:
            raise self._damaged("journal", f"line {sequence} is not as it was written")
        try:
            fact = FACT.validate_json(text)
        except ValidationError as error:
            raise self._damaged(
                "journal", f"line {sequence} cannot be read: {first_problem(error)}"
            ) from None
        self._sequence, self._digest = sequence, digest
        return fact

    def _damaged(self, table: str, what: str) -> StoreDamagedError:
        return StoreDamagedError(
            f"The table '{table}' is damaged: {what}.",
            where=self.place,
            fault=Fault.DATA,
            remedy="restore the database from a backup; stations keep every record not acknowledged.",
        )


def _chained(previous_digest: str, text: str) -> str:
    return hashlib.sha256(f"{previous_digest}{text}".encode()).hexdigest()[:32]


def _keep_records(connection: Connection, records: list[tuple[AttemptRecord, KeepRecord]]) -> None:
    if not records:
        return
    connection.execute(insert(tables.ATTEMPTS), [_attempt_row(record, keep) for record, keep in records])
    measurements = [row for record, _ in records for row in _measurement_rows(record)]
    if measurements:
        connection.execute(insert(tables.MEASUREMENTS), measurements)
    recordings = [row for record, _ in records for row in _recording_rows(record)]
    if recordings:
        connection.execute(insert(tables.RECORDINGS), recordings)


def _keep_units(connection: Connection, units: list[KeepUnit]) -> None:
    if not units:
        return
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    upsert = dialect.insert(tables.UNITS)
    changing = ("disposition", "operation", "changed_at_s")
    upsert = upsert.on_conflict_do_update(
        index_elements=["serial"], set_={name: upsert.excluded[name] for name in changing}
    )
    connection.execute(
        upsert,
        [
            {
                "serial": unit.serial,
                "product": unit.product,
                "lot": unit.lot,
                "route": unit.route,
                "disposition": unit.disposition.value,
                "operation": unit.operation,
                "changed_at_s": unit.at_s,
            }
            for unit in units
        ],
    )


def _attempt_row(record: AttemptRecord, keep: KeepRecord) -> dict[str, Any]:
    lease = record.lease
    return {
        "attempt_id": keep.attempt_id,
        "fence": keep.fence,
        "serial": lease.unit.serial,
        "operation": lease.operation,
        "station": lease.station,
        "socket": lease.socket,
        "plan_name": lease.plan.name,
        "plan_version": lease.plan.version,
        "plan_sha256": lease.plan.sha256,
        "outcome": record.outcome.value,
        "fault": record.fault.value,
        "set_aside": keep.set_aside,
        "started_at_s": record.started_at_s,
        "ended_at_s": record.ended_at_s,
        "received_at_s": keep.received_at_s,
        "record": record.model_dump_json(),
    }


def _measurement_rows(record: AttemptRecord) -> Iterator[dict[str, Any]]:
    attempt_id, fence, serial = record.attempt_id, record.lease.fence, record.lease.unit.serial
    for step in record.steps:
        for measurement in step.measurements:
            value, text = _value_columns(measurement)
            specification = measurement.specification
            yield {
                "attempt_id": attempt_id,
                "fence": fence,
                "serial": serial,
                "step": step.step,
                "name": specification.name,
                "unit": specification.unit,
                "value": value,
                "text": text,
                "low": specification.low,
                "high": specification.high,
                "outcome": measurement.outcome.value,
            }


def _value_columns(measurement: Measurement) -> tuple[float | None, str | None]:
    """Numbers go to `value`; strings to `text`; booleans to both, as 0 or 1 and as a word."""
    value = measurement.value
    if isinstance(value, bool):
        return float(value), str(value).lower()
    if isinstance(value, str):
        return None, value.replace("\x00", "\ufffd")  # PostgreSQL has no NUL in a text
    return (None if value is None else float(value)), None


def _recording_rows(record: AttemptRecord) -> Iterator[dict[str, Any]]:
    for recording in record.recordings:
        yield {
            "sha256": recording.sha256,
            "attempt_id": record.attempt_id,
            "fence": record.lease.fence,
            "serial": record.lease.unit.serial,
            "station": record.lease.station,
            "path": recording.path,
            "size_bytes": recording.size_bytes,
            "sample_count": recording.sample_count,
            "description": recording.description,
        }


def _alarm_row(alarm: Alarm) -> dict[str, Any]:
    return {
        "raised_at_s": alarm.raised_at_s,
        "alarm": alarm.alarm,
        "subject": alarm.subject,
        "view": alarm.model_dump_json(),
    }
