"""docs/coordinator.md shows the tables that the code has."""

from pathlib import Path

from coordinator.state_tables import DOCUMENT, with_tables

ROOT = Path(__file__).parents[2]


def test_the_document_shows_the_present_tables() -> None:
    document = (ROOT / DOCUMENT).read_text(encoding="utf-8")
    assert document == with_tables(document), "run: python -m coordinator.state_tables"
    assert "| AT_STATION | `passed_last` | FINISHED |" in document
    assert "    LAPSED --> [*]" in document
