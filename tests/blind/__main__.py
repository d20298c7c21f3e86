"""`python -m tests.blind generate | diagnose | score | all`; see README.md.

Each step is a process of its own; `all` starts them one after the other, set by set.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

REPORT_WIDTH = 150
PARTS = {"quick": 1, "default": 1, "nightly": 20}
"""Recordings of a nightly set would fill a disk: it is made, diagnosed and thrown away in parts."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    commands = parser.add_subparsers(dest="command")
    for name in ("generate", "diagnose", "score", "all"):
        command = commands.add_parser(name)
        command.add_argument("--out", type=Path, required=name != "all", help="recordings of the cases")
        if name in ("generate", "score"):
            command.add_argument("--labels", type=Path, required=True)
        if name in ("diagnose", "score"):
            command.add_argument("--verdicts", type=Path, required=True)
        if name in ("generate", "all"):
            command.add_argument("--size", default="default", choices=tuple(PARTS))
            command.add_argument("--quick", dest="size", action="store_const", const="quick")
            command.add_argument("--nightly", dest="size", action="store_const", const="nightly")
            command.add_argument("--cases", type=int)
            command.add_argument("--seed", type=int, default=1)
        if name == "generate":
            command.add_argument("--part", type=int, nargs=2, default=(0, 1), help="which of how many parts")
        if name in ("diagnose", "all"):
            command.add_argument("--engine", default="gap_diagnosis.diagnosis:diagnose")
        command.add_argument("--workers", type=int, default=2)
        command.add_argument("--results", type=Path, default=Path("runs/blind/results.json"))
    return parser


def main(arguments: list[str]) -> int:
    """Run one step, or all of them. Returns the exit code: 1 where a goal is certainly missed."""
    if not arguments or arguments[0].startswith("--"):
        arguments = ["all", *arguments]
    chosen = _parser().parse_args(arguments)
    if chosen.command == "generate":
        from tests.blind.generate import generate

        generate(chosen.out, chosen.labels, size=chosen.size, seed=chosen.seed, cases=chosen.cases,
                 part=tuple(chosen.part), workers=chosen.workers)  # fmt: skip
    elif chosen.command == "diagnose":
        from tests.blind.engine_calls import diagnose_all

        diagnose_all(chosen.out, chosen.verdicts, workers=chosen.workers, engine_name=chosen.engine)
    elif chosen.command == "score":
        from tests.blind.verdicts import opened

        return _reported(opened(chosen.out, chosen.labels, chosen.verdicts), chosen.results)
    else:
        return _all(chosen)
    return 0


def _step(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "tests.blind", *map(str, words)], check=True)


def _all(chosen: argparse.Namespace) -> int:
    """Every part: generate, diagnose, throw the recordings away; then open the labels of all parts."""
    from tests.blind.verdicts import opened

    root = chosen.out or Path("runs/blind")
    shutil.rmtree(root, ignore_errors=True)
    parts = 1 if chosen.cases else PARTS[chosen.size]
    begin = time.perf_counter()
    folders = []
    for part in range(parts):
        out, labels, verdicts = (root / f"{name}-{part}" for name in ("cases", "labels", "verdicts"))
        count = ["--cases", chosen.cases] if chosen.cases else []
        _step("generate", "--out", out, "--labels", labels, "--size", chosen.size, "--seed", chosen.seed,
              "--part", part, parts, "--workers", chosen.workers, *count)  # fmt: skip
        _step("diagnose", "--out", out, "--verdicts", verdicts, "--engine", chosen.engine,
              "--workers", chosen.workers)  # fmt: skip
        for recordings in out.iterdir():
            if parts > 1 and recordings.is_dir():
                shutil.rmtree(recordings)
        folders.append((out, labels, verdicts))
    cases = [one for out, labels, verdicts in folders for one in opened(out, labels, verdicts)]
    return _reported(cases, root / "results.json", time.perf_counter() - begin)


def _reported(cases: list, results: Path, seconds: float | None = None) -> int:
    from rich.console import Console

    from tests.blind.case_plan import real_noise_folder
    from tests.blind.scorer import as_documents, scored
    from tests.blind.table import table

    rows = scored(cases)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = REPORT_WIDTH
    console.print(table(rows))
    if real_noise_folder() is None:
        console.print("[bold red]No semi-real cases: TESTLOOM_DATA does not lead to the real recordings.[/]")
    console.print(f"{len(cases)} cases" + ("" if seconds is None else f" in {seconds:.0f} s"))
    results.parent.mkdir(parents=True, exist_ok=True)
    document = {"cases": len(cases), "seconds": seconds, "rows": as_documents(rows)}
    results.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return 1 if any(row.state == "short" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
