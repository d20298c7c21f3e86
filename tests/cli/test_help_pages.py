"""Help pages are whole in both languages, also on a narrow terminal."""

import subprocess
import sys

import pytest

from cli.main import COMMANDS

ENGLISH_OF_TYPER = (
    "Options",
    "Arguments",
    "Commands",
    "Show this message",
    "[default",
    "[required]",
    "Try '",
)


@pytest.mark.parametrize("command", ["", "up", "recording", "bench"])
def test_a_chinese_help_page_is_chinese_and_nothing_is_cut_off(command: str) -> None:
    assert not command or command in COMMANDS
    words = [sys.executable, "-m", "cli.main", "--lang", "zh", *([command] if command else []), "--help"]
    page = subprocess.run(
        words,
        capture_output=True,
        text=True,
        timeout=60,
        env={"COLUMNS": "80", "PYTHONUTF8": "1"},
        check=True,
    ).stdout
    assert "…" not in page
    assert not [words for words in ENGLISH_OF_TYPER if words in page]
    assert "选项" in page
