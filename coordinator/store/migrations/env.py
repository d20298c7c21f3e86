"""Alembic's way in: `schema.migrate` hands over an open connection."""

from alembic import context

from coordinator.store.tables import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
with context.begin_transaction():
    context.run_migrations()
