"""The store: one conformance class, run on SQLite and on PostgreSQL."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from coordinator.store.line_store import Batch, LineStore
from coordinator.store.schema import StoreConflictError, StoreDamagedError, StoreUnavailableError
from coordinator.store.tables import METADATA
from protocol.attempts import Lease, RecordingReference, StepRecord, UnitIdentity
from protocol.coordinator_commands import KeepRecord, KeepUnit
from protocol.coordinator_events import SequenceAccepted
from protocol.errors import TestloomError
from protocol.line_views import Alarm
from protocol.outcomes import Disposition, Outcome
from protocol.plans import PlanReference

LEASE = Lease(
    fence=1,
    attempt_id="GM-1.functional.1",
    unit=UnitIdentity(serial="GM-1", product="gnc_module", lot="L1"),
    operation="functional",
    station="F1",
    socket="A",
    plan=PlanReference(operation="functional", name="functional", version="1", sha256="a" * 64),
)


def facts(count: int, first: int = 1) -> list[SequenceAccepted]:
    return [SequenceAccepted(at_s=float(number), fence=number) for number in range(first, first + count)]


class StoreConformance:
    """What every database has to do. A subclass gives `url`: an empty database."""

    @pytest.fixture
    def store(self, url: str) -> Iterator[LineStore]:
        store = LineStore(url, "line-1")
        assert list(store.facts()) == []
        yield store
        store.close()

    def run(self, url: str, statement: str) -> None:
        """Somebody's hand in the database."""
        engine = create_engine(url)
        with engine.begin() as connection:
            connection.execute(text(statement))
        engine.dispose()

    def rows(self, url: str, query: str) -> list[tuple]:
        engine = create_engine(url)
        with engine.connect() as connection:
            found = [tuple(row) for row in connection.execute(text(query))]
        engine.dispose()
        return found

    def test_the_journal_comes_back_in_its_order(self, store: LineStore, url: str) -> None:
        store.commit(Batch(facts=facts(3)))
        store.commit(Batch(facts=facts(2, first=4)))
        store.close()
        again = LineStore(url, "line-1")
        assert list(again.facts()) == facts(5)
        again.commit(Batch(facts=facts(1, first=6)))
        assert list(again.facts()) == facts(6)
        again.close()

    def test_a_record_comes_back_as_it_was_and_its_values_are_rows(
        self, store: LineStore, url: str, record_of: Callable, measurement_of: Callable
    ) -> None:
        measurements = (
            measurement_of("rail_v", 5.01, unit="V", low=4.75, high=5.25),
            measurement_of("firmware", "1.2\x00", equals="1.2"),
            measurement_of("self_test", True, equals=True),
            measurement_of("never_taken", None, unit="s", high=1.0),
        )
        step = StepRecord(
            step="power",
            section="main",
            outcome=Outcome.FAIL,
            started_bench_s=0.0,
            ended_bench_s=1.0,
            measurements=measurements,
        )
        recording = RecordingReference(sha256="c" * 64, path="r.mcap", size_bytes=10, sample_count=2)
        record = record_of(LEASE, Outcome.FAIL, steps=(step,)).model_copy(update={"recordings": (recording,)})
        store.commit(Batch(records=[(record, KeepRecord(LEASE.attempt_id, 1, True, 12.5))]))
        (view,) = store.attempts_of("GM-1")
        assert (view.record, view.set_aside, view.received_at_s) == (record, True, 12.5)
        assert store.attempts_of("GM-2") == ()
        assert self.rows(url, "SELECT name, value, text, low, high, unit, outcome FROM measurements") == [
            ("rail_v", 5.01, None, 4.75, 5.25, "V", "PASS"),
            ("firmware", None, "1.2\ufffd", None, None, "1", "FAIL"),
            ("self_test", 1.0, "true", None, None, "1", "PASS"),
            ("never_taken", None, None, None, 1.0, "s", "UNSET"),
        ]
        assert self.rows(url, "SELECT sha256, serial FROM recordings") == [("c" * 64, "GM-1")]

    def test_a_unit_has_one_row_that_follows_it(self, store: LineStore, url: str) -> None:
        for operation, disposition in (("functional", Disposition.IN_PROCESS), (None, Disposition.SHIP)):
            kept = KeepUnit("GM-1", "gnc_module", "L1", "gnc_module", disposition, operation, 1.0)
            store.commit(Batch(units={"GM-1": kept}))
        assert self.rows(url, "SELECT serial, disposition, operation FROM units") == [("GM-1", "SHIP", None)]

    def test_alarms_come_back_oldest_first(self, store: LineStore) -> None:
        alarms = [
            Alarm(
                raised_at_s=float(n),
                alarm="spool_gap",
                subject="F1",
                text=f"{n}",
                template="{n}",
                values={"n": str(n)},
            )
            for n in range(4)
        ]
        store.commit(Batch(alarms=alarms[:2]))
        store.commit(Batch(alarms=alarms[2:]))
        assert store.recent_alarms(3) == tuple(alarms[1:])

    def test_a_batch_is_written_whole_or_not_at_all(
        self, store: LineStore, url: str, record_of: Callable
    ) -> None:
        record = (record_of(LEASE), KeepRecord(LEASE.attempt_id, 1, False, 1.0))
        store.commit(Batch(facts=facts(1), records=[record]))
        with pytest.raises(StoreConflictError):
            store.commit(Batch(facts=facts(1, first=2), records=[record]))
        assert list(store.facts()) == facts(1)
        assert len(store.attempts_of("GM-1")) == 1

    def test_a_second_coordinator_on_one_journal_fails_on_its_first_commit(
        self, store: LineStore, url: str
    ) -> None:
        other = LineStore(url, "line-1")
        assert list(other.facts()) == []
        store.commit(Batch(facts=facts(1)))
        with pytest.raises(StoreConflictError, match="Another coordinator"):
            other.commit(Batch(facts=facts(1)))
        other.close()

    @pytest.mark.parametrize(
        ("damage", "said"),
        [
            ("DELETE FROM journal WHERE sequence = 2", "lines 2 to 2 are missing"),
            ("UPDATE journal SET fact = replace(fact, '3.0', '4.0') WHERE sequence = 3", "line 3 is not as"),
            ("UPDATE journal SET digest = 'x' WHERE sequence = 1", "line 1 is not as it was written"),
        ],
    )
    def test_a_damaged_journal_is_refused_with_the_line_that_is_wrong(
        self, store: LineStore, url: str, damage: str, said: str
    ) -> None:
        store.commit(Batch(facts=facts(4)))
        self.run(url, damage)
        with pytest.raises(StoreDamagedError, match=said):
            list(store.facts())

    def test_a_database_of_another_line_or_version_is_refused(self, store: LineStore, url: str) -> None:
        with pytest.raises(StoreConflictError, match="belongs to line 'line-1'"):
            LineStore(url, "line-2")
        self.run(url, "UPDATE line SET journal_format = 99")
        with pytest.raises(StoreConflictError, match="format 99"):
            LineStore(url, "line-1")
        self.run(url, "UPDATE alembic_version SET version_num = 'from the future'")
        with pytest.raises(StoreConflictError, match="newer version"):
            LineStore(url, "line-1")

    def test_the_migrations_make_the_tables_that_the_code_names(self, store: LineStore, url: str) -> None:
        from alembic.autogenerate import compare_metadata
        from alembic.migration import MigrationContext

        engine = create_engine(url)
        with engine.connect() as connection:
            differences = compare_metadata(MigrationContext.configure(connection), METADATA)
        engine.dispose()
        assert differences == []


class TestSqliteStore(StoreConformance):
    @pytest.fixture
    def url(self, tmp_path: Path) -> str:
        return f"sqlite:///{tmp_path / 'line.db'}"

    def test_what_is_committed_survives_and_is_synced(self, store: LineStore) -> None:
        with store._engine.connect() as connection:
            assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
            assert connection.execute(text("PRAGMA synchronous")).scalar() == 2  # FULL

    def test_a_full_disk_is_said_and_goes_on_when_there_is_room(self, store: LineStore) -> None:
        store.commit(Batch(facts=facts(1)))
        engine = store._engine
        with engine.connect() as connection:
            pages = connection.execute(text("PRAGMA page_count")).scalar()
            connection.execute(text(f"PRAGMA max_page_count={pages}"))
        with pytest.raises(StoreUnavailableError, match="full") as caught:
            store.commit(Batch(facts=facts(2_000, first=2)))
        assert "make room" in caught.value.remedy
        with engine.connect() as connection:
            connection.execute(text("PRAGMA max_page_count=1000000"))
        store.commit(Batch(facts=facts(2_000, first=2)))
        assert len(list(store.facts())) == 2_001

    def test_a_locked_database_is_said(
        self, store: LineStore, url: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with store._engine.connect() as connection:
            connection.execute(text("PRAGMA busy_timeout=10"))
        holder = create_engine(url)
        with holder.connect() as connection:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            with pytest.raises(StoreUnavailableError, match="locked"):
                store.commit(Batch(facts=facts(1)))
            connection.exec_driver_sql("ROLLBACK")
        holder.dispose()
        store.commit(Batch(facts=facts(1)))

    def test_a_file_that_is_no_database_and_a_folder_that_is_not_there(self, tmp_path: Path) -> None:
        wrong = tmp_path / "wrong.db"
        wrong.write_bytes(b"this is a shopping list, not a database" * 100)
        with pytest.raises(StoreDamagedError):
            LineStore(f"sqlite:///{wrong}", "line-1")
        with pytest.raises(StoreUnavailableError, match="cannot be opened"):
            LineStore(f"sqlite:///{tmp_path}/nowhere/line.db", "line-1")

    @pytest.mark.parametrize("url", ["line.db", "mysql://host/line", "redis://host"])
    def test_a_url_of_something_else_is_refused(self, url: str) -> None:
        with pytest.raises(TestloomError, match="is not the URL"):
            LineStore(url, "line-1")


# --- PostgreSQL ------------------------------------------------------------------------------------


def _postgres_programs() -> Path | None:
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if found:
        return found[-1].parent
    on_path = shutil.which("initdb")
    return Path(on_path).parent if on_path else None


def _as_server_user(command: list[str], folder: Path) -> None:
    """initdb and postgres refuse to run as root: then they run as 'postgres' or 'nobody'."""
    user: dict[str, object] = {}
    if os.geteuid() == 0:
        names = {entry.pw_name for entry in pwd.getpwall()}
        account = pwd.getpwnam("postgres" if "postgres" in names else "nobody")
        os.chown(folder, account.pw_uid, account.pw_gid)
        user = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}
    done = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        **user,  # type: ignore[call-overload]
    )
    assert done.returncode == 0, done.stderr


@contextmanager
def _postgres_server() -> Iterator[int]:
    programs = _postgres_programs()
    if programs is None:
        pytest.skip("no PostgreSQL server program on this machine (Debian: apt-get install postgresql)")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder = Path(tempfile.mkdtemp(prefix="testloom-postgres-"))
    options = f"-c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -p {port}"
    control = [str(programs / "pg_ctl"), "-D", str(folder / "data")]
    try:
        _as_server_user(
            [str(programs / "initdb"), "-D", str(folder / "data"), "-U", "testloom", "-A", "trust", "-N"],
            folder,
        )
        _as_server_user([*control, "-w", "-l", str(folder / "log"), "-o", options, "start"], folder)
        try:
            yield port
        finally:
            _as_server_user([*control, "-m", "immediate", "stop"], folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def postgres_port() -> Iterator[int]:
    with _postgres_server() as port:
        yield port


@pytest.mark.postgres
class TestPostgresStore(StoreConformance):
    @pytest.fixture
    def url(self, postgres_port: int) -> Iterator[str]:
        name = f"line_{time.monotonic_ns()}"
        admin = f"postgresql+psycopg://testloom@127.0.0.1:{postgres_port}/postgres"
        engine = create_engine(admin, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        yield f"postgresql+psycopg://testloom@127.0.0.1:{postgres_port}/{name}"
        with engine.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        engine.dispose()

    def test_a_server_that_is_away_is_said(self, store: LineStore, url: str) -> None:
        server, name = url.rsplit("/", 1)
        self.run(f"{server}/postgres", f"ALTER DATABASE {name} ALLOW_CONNECTIONS false")
        self.run(
            f"{server}/postgres",
            f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'",
        )
        with pytest.raises(StoreUnavailableError):
            store.commit(Batch(facts=facts(1)))
