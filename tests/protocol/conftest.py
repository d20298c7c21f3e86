"""What the tests of recordings share."""

import os
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


@pytest.fixture
def fill_disk() -> Iterator[Callable[[int], None]]:
    """Let no file of this process grow beyond so many bytes: what a full disk does, without one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def recorded_data() -> Path:
    """The folder with recordings of real sensors."""
    folder = Path(os.environ.get("TESTLOOM_DATA", "../shared/data"))
    if not folder.is_dir():
        pytest.skip(f"TESTLOOM_DATA ({folder}) has no recordings of real sensors")
    return folder
