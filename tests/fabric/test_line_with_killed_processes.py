"""Lines whose processes are killed at random moments: nothing is lost, nothing is recorded twice."""

from pathlib import Path

import pytest
from kill_processes import run_line

pytestmark = [pytest.mark.fabric, pytest.mark.xdist_group("line"), pytest.mark.timeout(400)]


def test_killed_processes_cost_no_result(tmp_path: Path) -> None:
    result = run_line(["coordinator", "station", "router"], kills=3, seed=5, folder=tmp_path)
    assert len(result.kills) == 3, "the line was over before"
    assert result.faults() == []


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("role", ["station", "router", "coordinator", "bench"])
def test_twenty_kills_of_each(role: str, tmp_path: Path) -> None:
    kills = 0
    for number in range(20):
        folder = tmp_path / str(number)
        folder.mkdir()
        result = run_line([role], kills=min(5, 20 - kills), seed=100 + number, folder=folder)
        assert result.faults() == [], result
        kills += len(result.kills)
        if kills >= 20:
            break
    assert kills >= 20
