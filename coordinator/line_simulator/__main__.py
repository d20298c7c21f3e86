"""Run the line simulator.

python -m coordinator.line_simulator --seed 7                 one line through faults
python -m coordinator.line_simulator --seeds 0:2000           many, on all cores
python -m coordinator.line_simulator --seeds 0:40 --planted-fault unfenced_lease
python -m coordinator.line_simulator --capacity --units 240   no faults: what the line can do
"""

import argparse
import os

from rich.console import Console

from coordinator.line_simulator.capacity import DEMONSTRATION_LINE, simulate
from coordinator.line_simulator.planted_faults import PLANTED_FAULTS
from coordinator.line_simulator.runs import SeedResult, replay_command, run_seeds

MAX_FAILURES_SHOWN = 5


def main() -> int:
    """0 when every seed passed, 1 when one did not."""
    arguments = _parse()
    console = Console(highlight=False)
    if arguments.capacity:
        _show_capacity(console, arguments.units, arguments.seed or 0)
        return 0
    seeds = range(arguments.seed, arguments.seed + 1) if arguments.seed is not None else arguments.seeds
    processes = arguments.processes if len(seeds) > 1 else 1
    failures: list[SeedResult] = []
    events = records = set_aside = restarts = 0
    for result in run_seeds(seeds, arguments.planted_fault, processes):
        events, records = events + result.events, records + result.records
        set_aside, restarts = set_aside + result.set_aside, restarts + result.restarts
        if result.problem:
            failures.append(result)
            _show_failure(console, result, arguments.planted_fault)
            if len(failures) >= MAX_FAILURES_SHOWN:
                break
    console.print(
        f"{len(seeds)} seeds: {len(failures)} failed; {events} events, {restarts} restarts of the "
        f"coordinator, {records} records kept, {set_aside} of them set aside."
    )
    return 1 if failures else 0


def _show_failure(console: Console, result: SeedResult, planted_fault: str) -> None:
    console.print(f"[red]seed {result.seed}[/red]: {result.problem}")
    for line in result.story[-10:]:
        console.print(f"    {line}")
    console.print(f"    again: {replay_command(result.seed, planted_fault)}", soft_wrap=True)


def _show_capacity(console: Console, units: int, seed: int) -> None:
    report = simulate(DEMONSTRATION_LINE, units, seed)
    console.print(
        f"{report.units} units in {report.makespan_s:.0f} s: {report.units_per_hour:.1f} units/h, "
        f"mean flow time {report.mean_flow_s:.0f} s, {report.shipped} shipped."
    )
    for operation, fraction in report.utilisation.items():
        note = " (bottleneck)" if operation == report.bottleneck else ""
        console.print(f"  {operation}: sockets busy {fraction:.0%}{note}")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m coordinator.line_simulator", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--seed", type=int, help="one seed")
    parser.add_argument("--seeds", type=_seed_range, default=range(100), help="A:B, B not included")
    parser.add_argument("--planted-fault", default="", choices=["", *PLANTED_FAULTS])
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--capacity", action="store_true", help="no faults; what can the line do?")
    parser.add_argument("--units", type=int, default=240)
    return parser.parse_args()


def _seed_range(text: str) -> range:
    first, _, last = text.partition(":")
    return range(int(first), int(last))


if __name__ == "__main__":
    raise SystemExit(main())
