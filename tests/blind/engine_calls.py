"""The only step that calls the engine. It is given recordings and nothing else: labels have no path here."""

import importlib
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

MANIFEST = "cases.json"
ENGINE = "gap_diagnosis.diagnosis:diagnose"


def engine(name: str = ENGINE) -> Callable[..., Any]:
    """The engine by `module:function`; imported here and nowhere else."""
    module, function = name.split(":")
    return getattr(importlib.import_module(module), function)


def _verdict(arguments: tuple[Path, Path, list[str], str, str]) -> str:
    """Diagnose one case and write the verdict whole; an engine that raises is a verdict too."""
    from protocol.adapters.recording_forms import read_recording

    folder, target, without, seal, engine_name = arguments
    recordings = [read_recording(path) for path in sorted(folder.iterdir()) if path.is_dir()]
    rows = sum(len(recording.streams["dut"]) for recording in recordings)
    verdict: dict[str, Any] = {"case": folder.name, "seal": seal, "without": without, "rows": rows}
    start, wall = time.process_time(), time.perf_counter()
    try:
        options = {"without": set(without)} if without else {}
        report = engine(engine_name)(recordings, **options)
        verdict["report"] = report.document
    except Exception as error:  # noqa: BLE001 - whatever it is, it is the engine's answer to this case
        verdict["error"] = f"{type(error).__name__}: {error}"
    verdict |= {"cpu_s": time.process_time() - start, "wall_s": time.perf_counter() - wall}
    partial = target.with_suffix(".part")
    partial.write_text(json.dumps(verdict, default=str), encoding="utf-8")
    os.replace(partial, target)
    return folder.name


def diagnose_all(
    out: Path, verdicts: Path, *, workers: int = 2, engine_name: str = ENGINE, limit: int | None = None
) -> int:
    """Diagnose every case of a set. Returns how many; raises ImportError if there is no engine."""
    engine(engine_name)
    verdicts.mkdir(parents=True, exist_ok=True)
    manifest = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
    jobs = [
        (out / one["case"], verdicts / f"{one['case']}.json", one["without"], one["seal"], engine_name)
        for one in manifest["cases"][:limit]
    ]
    if workers <= 1:
        return len([_verdict(job) for job in jobs])
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return len(list(pool.map(_verdict, jobs, chunksize=1)))
