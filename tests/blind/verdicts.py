"""Sealed labels and the verdicts beside them: opened only when every verdict is on the disk."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.blind.engine_calls import MANIFEST


class SealError(Exception):
    """A verdict is missing or older than its case, or a label is not the one that was sealed."""


@dataclass(frozen=True)
class Judged:
    """One case with its label and what the engine said."""

    label: dict[str, Any]
    verdict: dict[str, Any]

    @property
    def report(self) -> dict[str, Any]:
        """The engine's report; empty where it failed."""
        return self.verdict.get("report", {})

    @property
    def said(self) -> str:
        """The report's verdict, `error` where there is none."""
        return str(self.report.get("verdict", "error"))

    @property
    def truth(self) -> list[str]:
        """Names of the hidden effects."""
        return list(self.label["effects"])

    @property
    def oracle(self) -> dict[str, Any]:
        """What the oracle said."""
        return self.label["oracle"]

    def named(self, count: int) -> list[str]:
        """The first effects that the report names."""
        return [str(one["effect"]) for one in self.report.get("which", [])[:count]]

    def sets(self) -> list[tuple[frozenset[str], float]]:
        """Joint sets with their probabilities, most probable first."""
        pairs = [
            (frozenset(one["effects"]), float(one["probability"])) for one in self.report.get("sets", [])
        ]
        return sorted(pairs, key=lambda pair: -pair[1])


def opened(out: Path, labels: Path, verdicts: Path) -> list[Judged]:
    """All cases of a set with their labels.

    Raises:
        SealError: see there; nothing of any label is returned then.
    """
    manifest = out / MANIFEST
    entries = json.loads(manifest.read_text(encoding="utf-8"))["cases"]
    made = manifest.stat().st_mtime_ns
    found: dict[str, dict[str, Any]] = {}
    for entry in entries:
        path = verdicts / f"{entry['case']}.json"
        if not path.exists():
            raise SealError(f"{entry['case']} has no verdict: diagnose every case first.")
        if path.stat().st_mtime_ns < made:
            raise SealError(f"{entry['case']}: the verdict is older than the case: diagnose again.")
        found[entry["case"]] = json.loads(path.read_text(encoding="utf-8"))
        if found[entry["case"]].get("seal") != entry["seal"]:
            raise SealError(f"{entry['case']}: the verdict belongs to another set.")
    texts = {
        entry["case"]: (labels / f"{entry['case']}.json").read_text(encoding="utf-8") for entry in entries
    }
    for entry in entries:
        if hashlib.sha256(texts[entry["case"]].encode()).hexdigest() != entry["seal"]:
            raise SealError(f"{entry['case']}: the label was changed after it was sealed.")
    return [Judged(json.loads(texts[name]), verdict) for name, verdict in found.items()]
