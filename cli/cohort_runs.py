"""A cohort from its recordings to its findings, over worker processes or a Dask cluster; can be resumed."""

import ipaddress
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from cli.cohort_units import (
    DiagnosedUnit,
    LeftOut,
    SeenRecording,
    diagnose_unit,
    estimate_unit,
    folder_of,
    look_at,
)
from gap_diagnosis.cohort import CohortFindings, cohort_findings
from gap_diagnosis.cohort_trials import cohort_trials
from gap_diagnosis.mount_estimates import MountEstimate
from protocol.adapters.recording_forms import recordings_below
from protocol.errors import Fault, TestloomError
from protocol.language import chosen_language

MAX_RECORDINGS = 5_000
MAX_WORKERS = 64
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Cohort:
    """What was made of all recordings."""

    product: str
    units: tuple[DiagnosedUnit, ...]
    left_out: tuple[LeftOut, ...]
    findings: CohortFindings


def cohort_of(
    paths: list[Path], out: Path, workers: int, scheduler: str | None, progress: Progress
) -> Cohort:
    """Look at all recordings, diagnose every unit, then weigh what its mounts say against the others'.

    Args:
        paths: recordings and folders of them, at any depth.
        out: reports of units are in `out/units`; one of the same recordings is kept.
        workers: processes of this machine.
        scheduler: address of a Dask scheduler on this machine instead.
        progress: told the step and the share of the whole that is done.

    Raises:
        TestloomError: no recordings, several products, no such scheduler.
    """
    found = list(dict.fromkeys(inside for path in paths for inside in recordings_below(path)))
    _refuse_count(found, paths)
    with _in_parallel(workers, scheduler) as run:
        seen: list[SeenRecording | LeftOut] = []
        for done, one in enumerate(run(look_at, [(path,) for path in found]), start=1):
            seen.append(one)
            progress("reading", 0.15 * done / len(found))
        by_unit, left_out = _by_unit(seen)
        product = _one_product(by_unit)
        jobs = [
            (serial, tuple(own), out / "units" / folder_of(serial), chosen_language())
            for serial, own in by_unit.items()
        ]
        units: list[DiagnosedUnit] = []
        for unit in run(diagnose_unit, jobs):
            units.append(unit)
            left_out += unit.left_out
            progress("units", 0.15 + 0.65 * len(units) / len(jobs))
        units.sort(key=lambda one: one.serial)
        diagnosed = [one for one in units if one.report is not None]
        trials = cohort_trials({one.serial: one.report for one in diagnosed if one.report is not None})
        mounts: list[MountEstimate] = []
        told = run(estimate_unit, [(one.serial, one.recordings, trials) for one in diagnosed])
        for done, own in enumerate(told, start=1):
            if isinstance(own, LeftOut):
                left_out.append(own)
            else:
                mounts += own
            progress("mounts", 0.8 + 0.15 * done / len(diagnosed))
    left_out.sort(key=lambda one: (one.what, one.why))
    return Cohort(product, tuple(units), tuple(left_out), cohort_findings(mounts))


def _by_unit(seen: Iterable[SeenRecording | LeftOut]) -> tuple[dict[str, list[SeenRecording]], list[LeftOut]]:
    """Units in order with their recordings; what is there twice counts once."""
    by_unit: dict[str, list[SeenRecording]] = {}
    left_out = [one for one in seen if isinstance(one, LeftOut)]
    known: dict[str, SeenRecording] = {}
    readable = sorted(
        (one for one in seen if isinstance(one, SeenRecording)), key=lambda one: (one.serial, str(one.path))
    )
    for one in readable:
        first = known.setdefault(one.recording_id, one)
        if first is not one:
            why = f"The recording '{one.recording_id}' is there already: {first.path}."
            left_out.append(LeftOut(str(one.path), why))
        else:
            by_unit.setdefault(one.serial, []).append(one)
    return by_unit, left_out


def _one_product(by_unit: dict[str, list[SeenRecording]]) -> str:
    products = sorted({one.product for own in by_unit.values() for one in own})
    if len(products) == 1:
        return products[0]
    what = "The recordings are of several products" if products else "No recording can be used"
    raise TestloomError(
        f"{what}: {', '.join(products)}." if products else f"{what}.",
        where="gap cohort",
        fault=Fault.OPERATOR,
        remedy="give recordings of units of one product; 'testloom recording check' says what is wrong.",
    )


def _refuse_count(found: list[Path], paths: list[Path]) -> None:
    if not 1 <= len(found) <= MAX_RECORDINGS:
        raise TestloomError(
            f"There are {len(found)} recordings; a cohort has 1 to {MAX_RECORDINGS}.",
            where=", ".join(map(str, paths)),
            fault=Fault.OPERATOR,
            remedy="name folders of recordings.",
        )


Run = Callable[[Callable[..., Any], list[tuple[Any, ...]]], Iterator[Any]]


@contextmanager
def _in_parallel(workers: int, scheduler: str | None) -> Iterator[Run]:
    """A function over many arguments, in worker processes; results as they come."""
    from joblib import Parallel, delayed, parallel_config

    def run(work: Callable[..., Any], jobs: list[tuple[Any, ...]]) -> Iterator[Any]:
        made = Parallel(
            n_jobs=-1 if scheduler else min(workers, MAX_WORKERS), return_as="generator_unordered"
        )
        yield from made(delayed(work)(*job) for job in jobs)

    if scheduler is None:
        with warnings.catch_warnings():
            # joblib replaces a worker that has grown, does its work again, and would say so on the terminal
            warnings.filterwarnings("ignore", "A worker stopped", UserWarning)
            yield run
        return
    with _dask_client(scheduler), parallel_config(backend="dask"):
        yield run


def _dask_client(address: str) -> Any:
    """A client of a scheduler on this machine.

    Raises:
        TestloomError: Dask is not installed, the address is not of this machine, or nothing answers there.
    """
    host = urlsplit(address if "://" in address else f"tcp://{address}").hostname or ""
    try:
        local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    if not local:
        raise TestloomError(
            f"The scheduler '{address}' is not on this machine.",
            where="--scheduler",
            fault=Fault.OPERATOR,
            remedy="give tcp://127.0.0.1:8786, or a tunnel's end on this machine.",
        )
    try:
        from distributed import Client
    except ImportError as error:
        raise TestloomError(
            "Dask is not installed: recordings cannot be handed to its cluster.",
            where="--scheduler",
            fault=Fault.OPERATOR,
            remedy="install the package 'distributed', or use --workers.",
        ) from error
    try:
        return Client(address, timeout="5s", set_as_default=True)
    except (OSError, TimeoutError) as error:
        raise TestloomError(
            f"No Dask scheduler answers at '{address}'.",
            where="--scheduler",
            fault=Fault.STATION,
            remedy="start one: dask scheduler --host 127.0.0.1, and workers beside it.",
        ) from error
