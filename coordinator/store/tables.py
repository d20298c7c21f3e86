"""The tables, as the newest migration leaves them.

`journal` is the truth of the line; `units` follows from it and is kept for whoever reads the
database with SQL. `attempts` keeps each record whole, as JSON; `measurements` has the same values
flat, one row each, for queries by unit and by name.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Double,
    Index,
    Integer,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Table,
    Text,
)

METADATA = MetaData()

_RowNumber = BigInteger().with_variant(Integer, "sqlite")  # SQLite numbers rows by INTEGER only

LINE = Table(
    "line",
    METADATA,
    Column("name", String, primary_key=True),
    Column("journal_format", Integer, nullable=False),
)

JOURNAL = Table(
    "journal",
    METADATA,
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),
    Column("at_s", Double, nullable=False),
    Column("kind", String, nullable=False),
    Column("fact", Text, nullable=False),
    Column("digest", String, nullable=False),
)

ATTEMPTS = Table(
    "attempts",
    METADATA,
    Column("attempt_id", String, nullable=False),
    Column("fence", BigInteger, nullable=False),
    Column("serial", String, nullable=False),
    Column("operation", String, nullable=False),
    Column("station", String, nullable=False),
    Column("socket", String, nullable=False),
    Column("plan_name", String, nullable=False),
    Column("plan_version", String, nullable=False),
    Column("plan_sha256", String, nullable=False),
    Column("outcome", String, nullable=False),
    Column("fault", String, nullable=False),
    Column("set_aside", Boolean, nullable=False),
    Column("started_at_s", Double, nullable=False),
    Column("ended_at_s", Double, nullable=False),
    Column("received_at_s", Double, nullable=False),
    Column("record", Text, nullable=False),
    PrimaryKeyConstraint("attempt_id", "fence"),
    Index("attempts_by_serial", "serial"),
)

MEASUREMENTS = Table(
    "measurements",
    METADATA,
    Column("number", _RowNumber, primary_key=True, autoincrement=True),
    Column("attempt_id", String, nullable=False),
    Column("fence", BigInteger, nullable=False),
    Column("serial", String, nullable=False),
    Column("step", String, nullable=False),
    Column("name", String, nullable=False),
    Column("unit", String, nullable=False),
    Column("value", Double),
    Column("text", Text),
    Column("low", Double),
    Column("high", Double),
    Column("outcome", String, nullable=False),
    Index("measurements_by_serial", "serial"),
    Index("measurements_by_name", "name"),
)

RECORDINGS = Table(
    "recordings",
    METADATA,
    Column("number", _RowNumber, primary_key=True, autoincrement=True),
    Column("sha256", String, nullable=False),
    Column("attempt_id", String, nullable=False),
    Column("fence", BigInteger, nullable=False),
    Column("serial", String, nullable=False),
    Column("station", String, nullable=False),
    Column("path", Text, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("sample_count", BigInteger, nullable=False),
    Column("description", Text, nullable=False),
    Index("recordings_by_serial", "serial"),
)

UNITS = Table(
    "units",
    METADATA,
    Column("serial", String, primary_key=True),
    Column("product", String, nullable=False),
    Column("lot", String, nullable=False),
    Column("route", String, nullable=False),
    Column("disposition", String, nullable=False),
    Column("operation", String),
    Column("changed_at_s", Double, nullable=False),
)

ALARMS = Table(
    "alarms",
    METADATA,
    Column("number", _RowNumber, primary_key=True, autoincrement=True),
    Column("raised_at_s", Double, nullable=False),
    Column("alarm", String, nullable=False),
    Column("subject", String, nullable=False),
    Column("view", Text, nullable=False),
)
