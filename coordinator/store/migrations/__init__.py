"""Alembic migrations of the line's database; `versions/` holds one file per step."""
