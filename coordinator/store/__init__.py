"""The line's database: journal and results in one transaction. SQLite by default, PostgreSQL by URL.

`LineStore` is the only way in. Tables are made and changed by Alembic migrations alone.
"""
