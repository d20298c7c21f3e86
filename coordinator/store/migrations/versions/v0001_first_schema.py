"""Journal, attempts, measurements, recordings, units, alarms."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def _text(name: str, *, nullable: bool = False) -> sa.Column[str]:
    return sa.Column(name, sa.String, nullable=nullable)


def _of_attempt() -> tuple[sa.Column[str], sa.Column[int], sa.Column[str]]:
    return (
        _text("attempt_id"),
        sa.Column("fence", sa.BigInteger, nullable=False),
        _text("serial"),
    )


def upgrade() -> None:
    """Make all tables."""
    op.create_table(
        "line",
        sa.Column("name", sa.String, primary_key=True),
        sa.Column("journal_format", sa.Integer, nullable=False),
    )
    op.create_table(
        "journal",
        sa.Column("sequence", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("at_s", sa.Double, nullable=False),
        _text("kind"),
        sa.Column("fact", sa.Text, nullable=False),
        _text("digest"),
    )
    op.create_table(
        "attempts",
        *_of_attempt(),
        _text("operation"),
        _text("station"),
        _text("socket"),
        _text("plan_name"),
        _text("plan_version"),
        _text("plan_sha256"),
        _text("outcome"),
        _text("fault"),
        sa.Column("set_aside", sa.Boolean, nullable=False),
        sa.Column("started_at_s", sa.Double, nullable=False),
        sa.Column("ended_at_s", sa.Double, nullable=False),
        sa.Column("received_at_s", sa.Double, nullable=False),
        sa.Column("record", sa.Text, nullable=False),
        sa.PrimaryKeyConstraint("attempt_id", "fence"),
    )
    op.create_index("attempts_by_serial", "attempts", ["serial"])
    _details()
    op.create_table(
        "units",
        sa.Column("serial", sa.String, primary_key=True),
        _text("product"),
        _text("lot"),
        _text("route"),
        _text("disposition"),
        _text("operation", nullable=True),
        sa.Column("changed_at_s", sa.Double, nullable=False),
    )
    op.create_table(
        "alarms",
        sa.Column("number", _NUMBER, primary_key=True, autoincrement=True),
        sa.Column("raised_at_s", sa.Double, nullable=False),
        _text("alarm"),
        _text("subject"),
        sa.Column("view", sa.Text, nullable=False),
    )


def _details() -> None:
    op.create_table(
        "measurements",
        sa.Column("number", _NUMBER, primary_key=True, autoincrement=True),
        *_of_attempt(),
        _text("step"),
        _text("name"),
        _text("unit"),
        sa.Column("value", sa.Double),
        sa.Column("text", sa.Text),
        sa.Column("low", sa.Double),
        sa.Column("high", sa.Double),
        _text("outcome"),
    )
    op.create_index("measurements_by_serial", "measurements", ["serial"])
    op.create_index("measurements_by_name", "measurements", ["name"])
    op.create_table(
        "recordings",
        sa.Column("number", _NUMBER, primary_key=True, autoincrement=True),
        _text("sha256"),
        *_of_attempt(),
        _text("station"),
        sa.Column("path", sa.Text, nullable=False),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("sample_count", sa.BigInteger, nullable=False),
        sa.Column("description", sa.Text, nullable=False),
    )
    op.create_index("recordings_by_serial", "recordings", ["serial"])


def downgrade() -> None:
    """Drop all tables: the journal is the line, so this is refused."""
    raise NotImplementedError("the first schema is not taken back: keep the database, or move it away")
