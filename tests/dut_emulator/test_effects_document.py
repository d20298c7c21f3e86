"""docs/effects.md says what the catalogue holds."""

from pathlib import Path

from dut_emulator.effects.catalogue import CATALOGUE
from dut_emulator.effects.document import document

WRITTEN = Path(__file__).resolve().parents[2] / "docs" / "effects.md"


def test_the_document_is_that_of_the_catalogue() -> None:
    assert WRITTEN.read_text(encoding="utf-8") == document(), (
        "python -m dut_emulator.effects.document > docs/effects.md"
    )


def test_every_effect_is_in_the_document_with_its_limits_of_validity() -> None:
    text = document()
    assert [name for name in CATALOGUE if f"`{name}`" not in text] == []
    assert [name for name, (kind, _) in CATALOGUE.items() if not kind.valid] == []
