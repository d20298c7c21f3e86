"""Where the recordings of real sensors are, if they are there: they are not part of this checkout."""

import os
from pathlib import Path

import pytest

ENVIRONMENT = "TESTLOOM_DATA"


def place() -> Path:
    """TESTLOOM_DATA, else ../shared/data beside this checkout; whether it exists is another question."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


def folder() -> Path:
    """The folder; the test is skipped where it is not there."""
    if not (place() / "imucal_ferraris").is_dir():
        pytest.skip(f"NO REAL RECORDINGS in {place()}: set {ENVIRONMENT} to their folder")
    return place()
