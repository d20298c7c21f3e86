"""Run the benchmarks, print each figure with its goal, end non-zero when one is short.

A module of this package named `bench_*` has `run() -> list[dict]` with the keys figure, value, unit,
goal, met, compared_with; a goal may be a number (at least) or text. `met` None: printed for information.

Linear algebra runs in one thread, ours and the peers': further threads that wait count as CPU time.
"""

import importlib
import json
import os
import pkgutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import benchmarks

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
REPORT_WIDTH = 160
"""Of the table in a file or a log, where no terminal says how wide it is."""


def main(names: list[str]) -> int:
    """Run the named benchmarks (all when none is named). Returns the exit code."""
    available = sorted(
        m.name for m in pkgutil.iter_modules(benchmarks.__path__) if m.name.startswith("bench_")
    )
    chosen = [name for name in available if not names or any(word in name for word in names)]
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = REPORT_WIDTH
    if not chosen:
        console.print(f"No benchmark is named so. There are: {', '.join(available)}")
        return 2
    rows: list[Mapping[str, Any]] = []
    for name in chosen:
        console.print(f"{name} …")
        rows += importlib.import_module(f"benchmarks.{name}").run()
    console.print(_table(rows))
    results = Path("runs") / "benchmarks.json"
    results.parent.mkdir(exist_ok=True)
    results.write_text(json.dumps(rows, indent=1))
    short = [row["figure"] for row in rows if row["met"] is False]
    console.print(f"{len(short)} short: {', '.join(short)}" if short else "All goals met.")
    return 1 if short else 0


def _table(rows: list[Mapping[str, Any]]) -> Table:
    table = Table(title="Benchmarks", header_style="bold")
    for heading in ("figure", "value", "unit", "goal", "", "measured beside it"):
        table.add_column(heading)
    words = {True: "[green]met[/]", False: "[bold red]short[/]", None: "–"}
    for row in rows:
        table.add_row(
            row["figure"],
            _number(row["value"]),
            row["unit"],
            _number(row["goal"]),
            words[row["met"]],
            str(row.get("compared_with", "")),
        )
    return table


def _number(value: object) -> str:
    return f"{value:,.4g}" if isinstance(value, float) else ("–" if value is None else str(value))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
