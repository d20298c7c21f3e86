"""What tests of all packages share."""

import os
import socket
from pathlib import Path

import pytest
from hypothesis import settings

from tests.real_recordings import folder

# before numpy: threads of small products wait for each other where two workers share two cores
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# how long an example takes says more about the machine's load than about the code
settings.register_profile("testloom", deadline=None)
settings.load_profile("testloom")


def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Where everything is required (in CI), a skip is a failure."""
    if call.excinfo and call.excinfo.errisinstance(pytest.skip.Exception) and _everything_is_required():
        pytest.fail(f"{item.nodeid} was skipped, and nothing may be: {call.excinfo.value}", pytrace=False)


def _everything_is_required() -> bool:
    return os.environ.get("TESTLOOM_REQUIRE_ALL") == "1"


@pytest.fixture(scope="session")
def recorded_data() -> Path:
    """The folder with recordings of real sensors."""
    return folder()


@pytest.fixture
def free_port_base() -> int:
    """First of some consecutive free ports, below those that the system hands out by itself."""
    for base in range(20_000 + os.getpid() % 100 * 100, 32_000, 50):
        try:
            for port in range(base, base + 50):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return base
    raise AssertionError("no fifty free ports in a row")


@pytest.fixture
def free_port() -> int:
    """A port of the loopback address that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
