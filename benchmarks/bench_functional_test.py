"""The functional test of one unit in real time, and the station's own share of it.

What physics and firmware ask for is the duration in lock-step, where time stands while the station
works; at pace 1 all of the station's work adds to it. The first sequence of a bench warms both up.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from protocol.attempts import Lease, UnitIdentity
from protocol.bench_description import BenchDescription
from protocol.outcomes import Outcome
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult, SequenceRunner
from stations.sequencing.step_registry import bundled_plans

REPETITIONS = 3
GOAL_REAL_TIME_S = 8.0
GOAL_OVERHEAD = 0.05
START_GUARD_S = 60.0
POLL_S = 0.02
SERIAL = "GNC-00000"
SEED = 7
"""A healthy unit of this lot."""


def run() -> list[dict[str, Any]]:
    """Measure."""
    with _bench("0") as description:
        results, lock_step_s = _sequences(description)
    needed_s = results[-1].duration_bench_s
    one_after_other_s = sum(step.ended_bench_s - step.started_bench_s for step in results[-1].steps)
    with _bench("1") as description:
        results, real_s = _sequences(description)
    overhead = real_s / needed_s - 1.0
    return [
        {
            "figure": "functional test in real time",
            "value": real_s,
            "unit": "s",
            "goal": f"≤ {GOAL_REAL_TIME_S:g}",
            "met": real_s <= GOAL_REAL_TIME_S,
            "compared_with": f"{one_after_other_s:.2f} s one test after the other",
        },
        {
            "figure": "station's own overhead at pace 1",
            "value": 100.0 * overhead,
            "unit": "%",
            "goal": f"≤ {100 * GOAL_OVERHEAD:g}",
            "met": overhead <= GOAL_OVERHEAD,
            "compared_with": f"{needed_s:.3f} s in lock-step",
        },
        {
            "figure": "functional test in lock-step",
            "value": lock_step_s,
            "unit": "s",
            "goal": None,
            "met": None,
            "compared_with": f"{needed_s:.3f} s of bench time",
        },
    ]


@contextmanager
def _bench(pace: str) -> Iterator[BenchDescription]:
    """A bench as a process of its own, until the end of the `with`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.json"
        command = [sys.executable, "-m", "cli.main", "bench", "--name", "benchmark", "--pace", pace]
        command += ["--seed", str(SEED), "--units-dir", f"{folder}/units", "--description", str(path)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            guard = time.monotonic() + START_GUARD_S
            while not path.exists():
                if process.poll() is not None or time.monotonic() > guard:
                    raise RuntimeError("the bench did not start")
                time.sleep(POLL_S)
            yield BenchDescription.model_validate_json(path.read_text())
        finally:
            process.terminate()
            process.wait()


def _sequences(description: BenchDescription) -> tuple[list[SequenceResult], float]:
    """Results, and the median wall time of those after the first."""
    plan = bundled_plans()["functional"]
    arbitration = Arbitration(description)
    with tempfile.TemporaryDirectory() as folder:
        runner = SequenceRunner(description, "1", arbitration, Path(folder))
        results: list[SequenceResult] = []
        wall_s: list[float] = []
        for number in range(1 + REPETITIONS):
            lease = Lease(
                fence=1 + number,
                attempt_id=f"benchmark-{number}",
                unit=UnitIdentity(serial=SERIAL, product=plan.product, lot="LOT"),
                operation=plan.operation,
                station="benchmark",
                socket="1",
                plan=plan.reference(),
            )
            began = time.perf_counter()
            results.append(runner.run(plan, lease, lambda _: None, AbortFlag()))
            wall_s.append(time.perf_counter() - began)
            if results[-1].outcome is not Outcome.PASS:
                raise RuntimeError(f"the unit did not pass: {results[-1].message}")
        runner.close()
        arbitration.close()
    return results, statistics.median(wall_s[1:])
