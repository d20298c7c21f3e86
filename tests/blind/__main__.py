"""`python -m tests.blind generate|diagnose|score|all`; see README.md."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
from pathlib import Path


def main(arguments: list[str]) -> int:
    """Run one step, or all of them. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("generate")
    make.add_argument("--out", type=Path, required=True)
    make.add_argument("--labels", type=Path, required=True)
    make.add_argument("--size", default="default", choices=("quick", "default", "nightly"))
    make.add_argument("--cases", type=int)
    make.add_argument("--seed", type=int, default=1)
    make.add_argument("--part", type=int, nargs=2, default=(0, 1))
    make.add_argument("--workers", type=int, default=1)
    chosen = parser.parse_args(arguments)
    if chosen.command == "generate":
        from tests.blind.generate import generate

        generate(chosen.out, chosen.labels, size=chosen.size, seed=chosen.seed, cases=chosen.cases,
                 part=tuple(chosen.part), workers=chosen.workers)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
