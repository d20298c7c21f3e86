"""The recordings that a gap command was given, each with the hash that a report knows it by."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.calibration_record_files import source_of
from gap_diagnosis.report_document import ReportDocument
from protocol.adapters.recording_forms import MCAP_SUFFIX, read_recording
from protocol.errors import Fault, RecordingError, TestloomError
from protocol.recording_document import DOCUMENT_NAME
from protocol.recordings import Recording

MAX_RECORDINGS = 200


@dataclass(frozen=True)
class NamedRecording:
    """A recording and where it was read from."""

    recording: Recording
    path: Path
    sha256: str

    def entry(self) -> dict[str, Any]:
        """As 'recordings' of report.json lists it."""
        return {
            "recording_id": self.recording.recording_id,
            "sha256": self.sha256,
            "serial": str(self.recording.unit.get("serial", "")),
            "profile": str(self.recording.test.get("profile", "")),
        }


def named_recordings(paths: list[Path]) -> list[NamedRecording]:
    """Recordings at paths; of a folder of recordings all of one form, folders before files.

    Raises:
        RecordingError: one is damaged or named twice: its evidence would count twice.
    """
    found = [inside for path in paths for inside in _inside(path)]
    if len(found) > MAX_RECORDINGS:
        raise RecordingError(
            f"{len(found)} recordings are more than {MAX_RECORDINGS}.",
            where=", ".join(map(str, paths)),
            fault=Fault.OPERATOR,
            remedy="diagnose those of one unit, or fewer of them.",
        )
    known: dict[str, Path] = {}
    named: list[NamedRecording] = []
    for path in found:
        recording = read_recording(path)
        if recording.recording_id in known:
            raise RecordingError(
                f"The recording '{recording.recording_id}' is given twice.",
                where=f"{known[recording.recording_id]}, {path}",
                fault=Fault.OPERATOR,
                remedy="name one of them: what is seen twice is not known twice as well.",
            )
        known[recording.recording_id] = path
        named.append(NamedRecording(recording, path, source_of(recording.recording_id, path).sha256))
    return named


def refuse_used(named: list[NamedRecording], report: ReportDocument) -> None:
    """What a gap was found in says nothing about what is left of it elsewhere.

    Raises:
        TestloomError: a recording that the report was made from, in whatever form.
    """
    identities = {one.recording_id for one in report.recordings}
    hashes = {one.sha256 for one in report.recordings}
    for one in named:
        if one.recording.recording_id in identities or one.sha256 in hashes:
            raise TestloomError(
                f"The report was made from the recording '{one.recording.recording_id}'.",
                where=str(one.path),
                fault=Fault.OPERATOR,
                remedy="verify with recordings that were not used: another run, mount or unit.",
            )


def _inside(path: Path) -> list[Path]:
    if not path.is_dir() or (path / DOCUMENT_NAME).exists():
        return [path]
    folders = sorted(document.parent for document in path.glob(f"*/{DOCUMENT_NAME}"))
    return folders or sorted(path.glob(f"*{MCAP_SUFFIX}")) or [path]
