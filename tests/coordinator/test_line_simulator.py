"""The seeded fault simulator: it passes, it repeats itself, and it finds what is planted."""

import os
import subprocess
import sys

import pytest

from coordinator.line_simulator.capacity import DEMONSTRATION_LINE, StationGroup, simulate
from coordinator.line_simulator.planted_faults import PLANTED_FAULTS, planted
from coordinator.line_simulator.runs import replay_command, run_seed, run_seeds
from protocol.errors import TestloomError

SEEDS_BY_DEFAULT = 100
SEEDS_IN_CHECK = 2_000
FEW_SEEDS = 60


def test_a_hundred_lines_survive_their_faults() -> None:
    results = list(run_seeds(range(SEEDS_BY_DEFAULT)))
    assert [(result.seed, result.problem) for result in results if result.problem] == []
    # The faults did happen: leases lapsed with work under way, the coordinator was killed.
    assert sum(result.set_aside for result in results) > 20
    assert sum(result.restarts for result in results) > 100
    assert sum(result.records for result in results) > 1_000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_thousand_lines_survive_their_faults() -> None:
    seeds = range(SEEDS_BY_DEFAULT, SEEDS_IN_CHECK)
    failed = [result for result in run_seeds(seeds, processes=os.cpu_count() or 1) if result.problem]
    assert [(replay_command(result.seed), result.problem) for result in failed] == []


@pytest.mark.parametrize("name", sorted(PLANTED_FAULTS))
def test_a_planted_fault_is_found_within_few_seeds(name: str) -> None:
    found = next((r for r in run_seeds(range(FEW_SEEDS), name) if r.problem), None)
    assert found is not None
    assert run_seed(found.seed, name).problem == found.problem, "its seed shows it again"
    assert run_seed(found.seed).problem == "", "without the fault the same seed passes"


def test_one_printed_command_shows_a_failing_seed_again() -> None:
    found = next(r for r in run_seeds(range(FEW_SEEDS), "recorded_twice") if r.problem)
    command = replay_command(found.seed, "recorded_twice")
    done = subprocess.run(
        [sys.executable, *command.split()[1:]], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert command in done.stdout
    assert "stored" in done.stdout


def test_a_seed_repeats_itself_to_the_last_event() -> None:
    assert run_seed(3) == run_seed(3)


def test_there_is_no_fault_by_another_name() -> None:
    with pytest.raises(TestloomError, match="no planted fault"), planted("gremlins"):
        pass


def test_a_line_without_faults_reaches_its_bottleneck() -> None:
    report = simulate(DEMONSTRATION_LINE, units=60, seed=1)
    assert report.bottleneck == "imu_calibration"
    # Two turntables at 30 ± 2 s and 2 % retests cannot do 60 units in less than 60 · 28 / 2 s.
    assert 60 * 28 / 2 < report.makespan_s < 60 * 30 * 1.1 / 2 + 60
    assert report.utilisation["imu_calibration"] > 0.95


def test_more_stations_at_the_bottleneck_make_the_line_faster() -> None:
    functional, turntables = DEMONSTRATION_LINE
    doubled = StationGroup("imu_calibration", 4, 1, turntables.service_s, 2.0, turntables.pass_fraction)
    slow = simulate(DEMONSTRATION_LINE, units=60, seed=1)
    fast = simulate((functional, doubled), units=60, seed=1)
    assert 1.7 < slow.makespan_s / fast.makespan_s < 2.1
