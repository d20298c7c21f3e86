"""Opening the database: engine, pragmas, migrations, and what can be wrong with it, in words."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.util import CommandError
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, IntegrityError, NoSuchModuleError
from sqlalchemy.pool import ConnectionPoolEntry

from protocol.errors import Fault, TestloomError

BUSY_TIMEOUT_MS = 2_000
CONNECT_TIMEOUT_S = 5
CHECKPOINT_PAGES = 4_000
"""SQLite moves its log into the database when it has so many pages: 16 MB, about 1,000 records."""


class StoreUnavailableError(TestloomError):
    """The database cannot be used now: nothing was written. Try again later."""


class StoreDamagedError(TestloomError):
    """The database is not what it was when it was last written."""


class StoreConflictError(TestloomError):
    """Somebody else writes to this line's journal, or the database belongs to another line."""


def open_engine(url: str) -> Engine:
    """An engine for the line's database. `url`: sqlite:///file or postgresql+psycopg://…

    Raises:
        TestloomError: the URL names no database that Testloom can use.
    """
    try:
        parsed = make_url(url)
        if parsed.drivername in ("postgresql", "postgres"):
            parsed = parsed.set(drivername="postgresql+psycopg")
        backend = parsed.get_backend_name()
        if backend not in ("sqlite", "postgresql"):
            raise ArgumentError(f"{backend} is neither sqlite nor postgresql")
        if backend == "sqlite":
            engine = create_engine(parsed)
            event.listen(engine, "connect", _set_pragmas)
            return engine
        return create_engine(parsed, pool_pre_ping=True, connect_args={"connect_timeout": CONNECT_TIMEOUT_S})
    except (ArgumentError, NoSuchModuleError) as error:
        raise TestloomError(
            f"'{url}' is not the URL of a database: {error}.",
            fault=Fault.OPERATOR,
            remedy="use sqlite:///path/to/line.db or postgresql://user:password@host/database.",
        ) from None


def migrate(engine: Engine) -> None:
    """Bring the schema to this version of Testloom.

    Raises:
        StoreUnavailableError: the database cannot be reached or written.
        StoreDamagedError: it is no database, or damaged.
        StoreConflictError: it was made by a newer version.
    """
    configuration = Config()
    configuration.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    try:
        with engine.begin() as connection:
            configuration.attributes["connection"] = connection
            command.upgrade(configuration, "head")
    except CommandError as error:
        raise StoreConflictError(
            "The database was made by a newer version of Testloom.",
            where=place_of(engine),
            fault=Fault.OPERATOR,
            remedy="use that version, or another database.",
            story=(str(error),),
        ) from None
    except DBAPIError as error:
        raise store_error(error, engine) from None


def place_of(engine: Engine) -> str:
    """Where the database is, without its password."""
    return engine.url.render_as_string(hide_password=True)


def store_error(error: DBAPIError, engine: Engine) -> TestloomError:
    """What a database error means for the line, and what to do."""
    text, where = str(error.orig or error).strip(), place_of(engine)
    low = text.lower()
    if isinstance(error, IntegrityError):
        return written_by_another(engine, text)
    if isinstance(error, DataError):
        return TestloomError(
            "A value cannot be stored in the database.",
            where=where,
            fault=Fault.DATA,
            remedy="look at the request that brought it.",
            story=(text,),
        )
    if "malformed" in low or "not a database" in low or "corrupt" in low:
        return StoreDamagedError(
            "The database is damaged.",
            where=where,
            fault=Fault.DATA,
            remedy="restore it from a backup; the stations keep every record that was not acknowledged.",
            story=(text,),
        )
    what, remedy = "The database does not answer.", "see that it runs and can be reached."
    if "full" in low or "no space" in low:
        what, remedy = "The disk under the database is full.", "make room: the line goes on by itself."
    elif "locked" in low:
        what, remedy = "The database is locked by another program.", "close that program."
    elif "readonly" in low or "read-only" in low:
        what, remedy = (
            "The database cannot be written.",
            "give this user the right to write the file and folder.",
        )
    elif "unable to open" in low:
        what, remedy = "The database cannot be opened.", "see that its folder exists and can be written."
    return StoreUnavailableError(what, where=where, fault=Fault.TESTLOOM, remedy=remedy, story=(text,))


def written_by_another(engine: Engine, story: str = "") -> StoreConflictError:
    """Two coordinators on one journal."""
    return StoreConflictError(
        "Another coordinator has written to this line's journal.",
        where=place_of(engine),
        fault=Fault.OPERATOR,
        remedy="run one coordinator per line: stop this one or the other.",
        story=(story,) if story else (),
    )


def _set_pragmas(connection: object, _entry: ConnectionPoolEntry) -> None:
    cursor = connection.cursor()  # pyright: ignore[reportAttributeAccessIssue]
    try:
        cursor.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")
        cursor.execute("PRAGMA journal_mode=WAL")
        cursor.execute("PRAGMA synchronous=FULL")
        cursor.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
    finally:
        cursor.close()
