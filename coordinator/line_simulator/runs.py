"""Running seeds, one after the other or on all cores."""

# pyright: strict

import multiprocessing
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from coordinator.line_simulator import verdict
from coordinator.line_simulator.planted_faults import planted
from coordinator.line_simulator.scenario import Scenario
from protocol.errors import TestloomError

SEEDS_PER_TASK = 10
MAX_PROCESSES = 8


class SeedResult(NamedTuple):
    """What became of one seed. `problem` is empty when all was well."""

    seed: int
    problem: str
    story: tuple[str, ...]
    events: int
    records: int
    set_aside: int
    restarts: int


def run_seed(seed: int, planted_fault: str = "") -> SeedResult:
    """One line through its faults, checked after every event and at the end."""
    with planted(planted_fault):
        scenario = Scenario(seed)
        problem, story = "", ()
        try:
            verdict.check(scenario, scenario.run())
        except TestloomError as error:
            problem, story = f"{type(error).__name__}: {error.what}", error.story
        except (KeyError, AssertionError) as error:  # a planted fault may break more than an invariant
            problem = f"{type(error).__name__}: {error}"
    kept = [record for records in scenario.coordinator.disk.records.values() for record in records]
    return SeedResult(
        seed,
        problem,
        tuple(story),
        scenario.coordinator.events_handled,
        len(kept),
        sum(record.set_aside for record in kept),
        scenario.coordinator.restarts,
    )


def run_seeds(seeds: Iterable[int], planted_fault: str = "", processes: int = 1) -> Iterator[SeedResult]:
    """Many seeds, in their order."""
    if processes <= 1:
        for seed in seeds:
            yield run_seed(seed, planted_fault)
        return
    tasks = [(seed, planted_fault) for seed in seeds]
    with multiprocessing.get_context("spawn").Pool(min(processes, MAX_PROCESSES)) as pool:
        yield from pool.imap(_run_task, tasks, chunksize=SEEDS_PER_TASK)


def _run_task(task: tuple[int, str]) -> SeedResult:
    return run_seed(*task)


def replay_command(seed: int, planted_fault: str = "") -> str:
    """The one command that shows a seed again."""
    command = f"python -m coordinator.line_simulator --seed {seed}"
    return f"{command} --planted-fault {planted_fault}" if planted_fault else command
