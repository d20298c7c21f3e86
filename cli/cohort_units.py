"""What a worker does for a cohort: look at a recording, diagnose a unit, estimate each of its mounts.

Each function stands alone and gives back data, never an exception: one bad recording of hundreds is named and
left out.
"""

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.calibration_record_files import source_of
from gap_diagnosis.candidates import Trial
from gap_diagnosis.mount_estimates import MountEstimate, mount_estimates
from gap_diagnosis.observation import Observation
from gap_diagnosis.report_document import ReportDocument, parse_report, read_report, report_text
from protocol.adapters.recording_forms import read_recording
from protocol.errors import TestloomError
from protocol.language import choose_language

REPORT = "report.json"
UNUSABLE = (TestloomError, ArithmeticError, ValueError)
"""What a recording that nobody foresaw may raise in a computation, beside our own errors."""


@dataclass(frozen=True)
class SeenRecording:
    """A recording that can be read."""

    path: Path
    recording_id: str
    serial: str
    product: str
    profile: str
    sha256: str

    def entry(self) -> dict[str, Any]:
        """As 'recordings' of report.json lists it."""
        return {
            "recording_id": self.recording_id,
            "sha256": self.sha256,
            "serial": self.serial,
            "profile": self.profile,
        }


@dataclass(frozen=True)
class LeftOut:
    """What is not used: a path or a serial number, and why, in English."""

    what: str
    why: str


@dataclass(frozen=True)
class DiagnosedUnit:
    """A unit with its report; None where there is none."""

    serial: str
    recordings: tuple[SeenRecording, ...]
    report: ReportDocument | None
    left_out: tuple[LeftOut, ...] = ()
    kept: bool = False


def look_at(path: Path) -> SeenRecording | LeftOut:
    """Read a recording for who it is of; it is not kept in memory."""
    try:
        recording = read_recording(path)
        serial = str(recording.unit.get("serial", ""))
        if not serial:
            return LeftOut(str(path), "The recording does not say which unit it is of.")
        return SeenRecording(
            path,
            recording.recording_id,
            serial,
            str(recording.unit.get("product", "")),
            str(recording.test.get("profile", "")),
            source_of(recording.recording_id, path).sha256,
        )
    except UNUSABLE as error:
        return LeftOut(str(path), _why(error))


def folder_of(serial: str) -> str:
    """A folder's name for a serial number; what is no name of a file gets a number that tells it apart."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", serial)
    return plain if plain == serial else f"{plain}-{zlib.crc32(serial.encode()):08x}"


def diagnose_unit(
    serial: str, recordings: Sequence[SeenRecording], folder: Path, language: str
) -> DiagnosedUnit:
    """The unit's report, from its folder if it is of these very recordings."""
    choose_language(language)
    kept = _kept_report(recordings, folder)
    if kept is not None:
        return DiagnosedUnit(serial, tuple(recordings), kept, kept=True)
    try:
        return DiagnosedUnit(serial, tuple(recordings), _diagnosed(recordings, folder))
    except UNUSABLE as error:
        usable, left_out = _observable(recordings)
        if not left_out or not usable:
            return DiagnosedUnit(serial, (), None, (*left_out, LeftOut(serial, _why(error))))
    kept = _kept_report(usable, folder)
    if kept is not None:
        return DiagnosedUnit(serial, tuple(usable), kept, tuple(left_out), kept=True)
    try:
        return DiagnosedUnit(serial, tuple(usable), _diagnosed(usable, folder), tuple(left_out))
    except UNUSABLE as error:
        return DiagnosedUnit(serial, (), None, (*left_out, LeftOut(serial, _why(error))))


def estimate_unit(
    serial: str, recordings: Sequence[SeenRecording], trials: Sequence[Trial]
) -> tuple[MountEstimate, ...] | LeftOut:
    """Parameters and matrices of each mount."""
    try:
        return mount_estimates(_observations(recordings), trials)
    except UNUSABLE as error:
        return LeftOut(serial, _why(error))


def _observations(recordings: Sequence[SeenRecording]) -> list[Observation]:
    """As `diagnose` makes them."""
    from gap_diagnosis.decimation import decimated
    from gap_diagnosis.observing import observe
    from gap_diagnosis.spectral_lines import lines_taken_off
    from gap_diagnosis.stillness import stilled

    observed = [stilled(observe(read_recording(one.path))) for one in recordings]
    return [decimated(one) for one in lines_taken_off(observed)]


def _observable(recordings: Sequence[SeenRecording]) -> tuple[list[SeenRecording], list[LeftOut]]:
    from gap_diagnosis.observing import observe

    usable: list[SeenRecording] = []
    left_out: list[LeftOut] = []
    for one in recordings:
        try:
            observe(read_recording(one.path))
            usable.append(one)
        except UNUSABLE as error:
            left_out.append(LeftOut(str(one.path), _why(error)))
    return usable, left_out


def _diagnosed(recordings: Sequence[SeenRecording], folder: Path) -> ReportDocument:
    from cli.gap_commands import write_report
    from gap_diagnosis.diagnosis import diagnose

    report = diagnose([read_recording(one.path) for one in recordings])
    text = report_text({**report.document, "recordings": [one.entry() for one in recordings]})
    document = parse_report(text)
    write_report(report, document, text, folder)
    return document


def _kept_report(recordings: Sequence[SeenRecording], folder: Path) -> ReportDocument | None:
    """The report in the folder if it was made from exactly these files."""
    if not (folder / REPORT).is_file():
        return None
    try:
        report = read_report(folder)
    except TestloomError:
        return None  # cut short or of another version: it is made again
    made_from = sorted((one.recording_id, one.sha256) for one in report.recordings)
    return report if made_from == sorted((one.recording_id, one.sha256) for one in recordings) else None


def _why(error: Exception) -> str:
    return str(error) or type(error).__name__
