"""What the tests of recordings share."""

import resource
from collections.abc import Callable, Iterator

import pytest


@pytest.fixture
def fill_disk() -> Iterator[Callable[[int], None]]:
    """Let no file of this process grow beyond so many bytes: what a full disk does, without one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
