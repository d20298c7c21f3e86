"""Recordings of either form, by path: a folder with `recording.json`, or an `.mcap` file."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from protocol.adapters.mcap_form import examine_mcap, write_mcap
from protocol.errors import Fault, RecordingError
from protocol.folder_form import examine_folder, write_folder
from protocol.recording_checks import Findings
from protocol.recording_document import DOCUMENT_NAME
from protocol.recordings import Recording
from protocol.stream_files import StreamFormat

MCAP_SUFFIX = ".mcap"
MAX_RECORDINGS = 100_000
"""So many are looked for below a folder."""


def read_recording(path: Path | str) -> Recording:
    """The recording at a path, whichever its form.

    Raises:
        RecordingError: there is none, or it is damaged; the error names the first thing found, its
            story the others.
    """
    findings = Findings()
    recording = examine_recording(Path(path), findings)
    findings.raise_first()
    assert recording is not None
    return recording


def examine_recording(path: Path, findings: Findings) -> Recording | None:
    """Read a recording and report everything that is wrong with it; None if it cannot be used."""
    if path.is_dir():
        return examine_folder(path, findings)
    if path.name == DOCUMENT_NAME:
        return examine_folder(path.parent, findings)
    if not path.exists():
        findings.add("There is no such file or folder.", str(path), "check the name.", Fault.OPERATOR)
        return None
    if path.suffix == MCAP_SUFFIX:
        return examine_mcap(path, findings)
    remedy = f"name a folder with {DOCUMENT_NAME} or a {MCAP_SUFFIX} file."
    findings.add("This is no recording.", str(path), remedy, Fault.OPERATOR)
    return None


def recordings_below(path: Path) -> list[Path]:
    """The recording at a path, else all recordings below it; the path itself if there is none."""
    if not path.is_dir() or (path / DOCUMENT_NAME).exists():
        return [path]
    found = sorted(islice(_search(path), MAX_RECORDINGS))
    return found or [path]


def _search(path: Path) -> Iterator[Path]:
    yield from (document.parent for document in path.rglob(DOCUMENT_NAME))
    yield from path.rglob(f"*{MCAP_SUFFIX}")


def form_of(path: Path) -> str:
    """'mcap' or 'folder', by the name alone."""
    return "mcap" if path.suffix == MCAP_SUFFIX else "folder"


def convert(source: Path | str, target: Path | str, stream_format: StreamFormat = "npz") -> Recording:
    """Write the recording at `source` in the form that the name of `target` asks for, without loss.

    Raises:
        RecordingError: the source is damaged, the target exists, or the disk refuses.
    """
    recording = read_recording(source)
    path = Path(target)
    if path.exists():
        raise RecordingError(
            "There is something of this name already.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="choose another name, or move it away.",
        )
    if form_of(path) == "mcap":
        write_mcap(recording, path)
    else:
        write_folder(recording, path, stream_format)
    return recording
