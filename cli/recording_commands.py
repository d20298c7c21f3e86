"""`testloom recording`: convert, info and check, for recordings of either form."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.help_pages import Command, Group
from protocol.language import say, translated

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from protocol.errors import TestloomError
    from protocol.recording_checks import Findings
    from protocol.recordings import Recording

EXIT_UNUSABLE = 1
MAX_ERRORS_SHOWN = 50
"""Of one recording, to a person; JSON holds them all."""

app = typer.Typer(cls=Group, no_args_is_help=True, help=say("Recordings: convert, look at, check them."))

Paths = Annotated[
    list[Path], typer.Argument(help=say("Recordings (folders or .mcap files), or folders of them."))
]
AsJson = Annotated[bool, typer.Option("--json", help=say("Print JSON."))]


@dataclass(frozen=True)
class _Examined:
    """A recording as found: None if it cannot be used."""

    path: Path
    recording: "Recording | None"
    findings: "Findings"


@app.command(cls=Command, help=say("Write a recording in the other form, without loss."))
def convert(
    source: Annotated[Path, typer.Argument(help=say("The recording: a folder or an .mcap file."))],
    target: Annotated[Path, typer.Argument(help=say("What to write: NAME.mcap, or the name of a folder."))],
    stream_format: Annotated[
        Literal["npz", "csv", "parquet"],
        typer.Option("--stream-format", help=say("Files of a folder's streams: npz, csv or parquet.")),
    ] = "npz",
    as_json: AsJson = False,
) -> None:
    from protocol.adapters.recording_forms import convert as convert_recording

    recording = convert_recording(source, target, stream_format)
    samples = sum(len(stream) for stream in recording.streams.values())
    if as_json:
        written = {"recording_id": recording.recording_id, "target": str(target), "samples": samples}
        typer.echo(json.dumps(written | _file_facts(target), ensure_ascii=False))
    else:
        named = {"recording": recording.recording_id, "samples": samples, "target": target}
        typer.echo(say("{recording}: {samples} samples written to {target}", **named))


@app.command(cls=Command, help=say("Show what recordings hold."))
def info(paths: Paths, as_json: AsJson = False) -> None:
    examined = _examine(paths)
    if as_json:
        typer.echo(json.dumps([_info(one) for one in examined], ensure_ascii=False))
    else:
        console = _console()
        for one in examined:
            if one.recording is None:
                _show_errors(console, one)
            else:
                console.print(_table(one.path, one.recording))
    _exit_if_unusable(examined)


@app.command(cls=Command, help=say("Check recordings and list all that is wrong with them."))
def check(paths: Paths, as_json: AsJson = False) -> None:
    examined = _examine(paths)
    if as_json:
        typer.echo(json.dumps([_verdict(one) for one in examined], ensure_ascii=False))
    else:
        console = _console()
        for one in examined:
            if one.recording is None:
                _show_errors(console, one)
            else:
                console.print(say("{path}: sound", path=one.path), style="green", markup=False)
            for note in _notes(one):
                console.print(f"  {note}", markup=False)
        unusable = sum(one.recording is None for one in examined)
        console.print(
            say("{count} recordings, {unusable} cannot be used", count=len(examined), unusable=unusable)
        )
    _exit_if_unusable(examined)


def _console() -> "Console":
    from rich.console import Console

    return Console(highlight=False)


def _examine(paths: list[Path]) -> list[_Examined]:
    from protocol.adapters.recording_forms import examine_recording, recordings_below
    from protocol.recording_checks import Findings

    examined: list[_Examined] = []
    for path in (found for named in paths for found in recordings_below(named)):
        findings = Findings()
        examined.append(_Examined(path, examine_recording(path, findings), findings))
    return examined


def _exit_if_unusable(examined: list[_Examined]) -> None:
    if any(one.recording is None for one in examined):
        raise typer.Exit(EXIT_UNUSABLE)


def _notes(one: _Examined) -> list[str]:
    """What is worth knowing of a usable recording: missing values, and what looked odd."""
    from protocol.recording_checks import missing_values

    notes = list(one.findings.notes)
    for stream in one.recording.streams.values() if one.recording else ():
        for column, count in missing_values(stream).items():
            named = {"stream": stream.name, "column": column, "count": count, "samples": len(stream)}
            notes.append(
                say("stream {stream}, column {column}: {count} of {samples} values are missing", **named)
            )
    return notes


def _verdict(one: _Examined) -> dict[str, Any]:
    return {
        "path": str(one.path),
        "sound": one.recording is not None,
        "errors": [
            {"what": error.what, "where": error.where, "fault": error.fault.value, "remedy": error.remedy}
            for error in one.findings.errors
        ],
        "notes": _notes(one),
    }


def _info(one: _Examined) -> dict[str, Any]:
    from protocol.adapters.recording_forms import form_of
    from protocol.recording_facts import stream_facts

    recording = one.recording
    if recording is None:
        return _verdict(one)
    return {
        "path": str(one.path),
        "sound": True,
        "form": form_of(one.path),
        **_file_facts(one.path),
        "recording_id": recording.recording_id,
        "unit": dict(recording.unit),
        "test": dict(recording.test),
        "stand": dict(recording.stand),
        "streams": {
            name: asdict(stream_facts(stream)) | {"clock": stream.clock, "columns": dict(stream.units)}
            for name, stream in recording.streams.items()
        },
    }


def _file_facts(path: Path) -> dict[str, Any]:
    """Size and SHA-256 of an MCAP file: the name by which results refer to it."""
    import hashlib

    if not path.is_file():
        return {}
    with path.open("rb") as file:
        return {"size_bytes": path.stat().st_size, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def _show_errors(console: "Console", one: _Examined) -> None:
    """What is wrong, where, and what to do, each in its place."""
    console.print(say("{path}: cannot be used", path=one.path), style="bold red", markup=False)
    for error, places in _grouped(one.findings.errors[:MAX_ERRORS_SHOWN]):
        console.print(f"  {translated(error.what)}", style="red", markup=False, soft_wrap=True)
        for place in places:
            console.print(f"    {say('Where')}: {place}", markup=False, soft_wrap=True)
        console.print(f"    {say('Fault')}: {say(error.fault.value)}", markup=False)
        remedy = translated(error.remedy)
        console.print(f"    {say('What to do')}: {remedy}", markup=False, soft_wrap=True)
    rest = len(one.findings.errors) - MAX_ERRORS_SHOWN
    if rest > 0:
        console.print("  " + say("and {count} more; --json lists them all", count=rest))


def _grouped(errors: Sequence["TestloomError"]) -> "list[tuple[TestloomError, list[str]]]":
    """Errors that say the same of several places, once with all the places."""
    places: dict[tuple[str, str, str], tuple[TestloomError, list[str]]] = {}
    for error in errors:
        places.setdefault((error.what, error.fault.value, error.remedy), (error, []))[1].append(error.where)
    return list(places.values())


def _table(path: Path, recording: "Recording") -> "Table":
    """The streams of a recording in numbers."""
    from rich.table import Table
    from rich.text import Text

    from protocol.recording_facts import stream_facts

    unit, test = recording.unit, recording.test
    about = [
        say("Unit {serial} ({product})", serial=unit.get("serial", "?"), product=unit.get("product", "?")),
        say("Profile: {profile}", profile=test.get("profile", "?")),
        str(path),
    ]
    facts_of_file = _file_facts(path)
    if facts_of_file:
        about.append(f"SHA-256 {facts_of_file['sha256']}")
    about += [f"{name}: {_columns(stream.units)}" for name, stream in recording.streams.items()]
    table = Table(title=Text(recording.recording_id), caption=Text("\n".join(about)), caption_justify="left")
    table.add_column(say("Stream"), no_wrap=True)
    for heading in (say("Samples"), say("Duration"), say("Rate"), say("Holes"), say("Missing")):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, stream in recording.streams.items():
        facts = stream_facts(stream)
        table.add_row(
            name,
            f"{facts.samples:,}",
            f"{facts.duration_s:,.1f} s",
            f"{facts.rate_hz:,.4g} Hz" if facts.rate_hz else "–",
            f"{facts.holes} (≤ {facts.longest_pause_s:.3g} s)" if facts.holes else "0",
            f"{sum(facts.missing.values()):,}",
        )
    return table


def _columns(units: Mapping[str, str]) -> str:
    """Columns with their units, neighbours of one unit together: `t [s], rate_x rate_y rate_z [deg/s]`."""
    return ", ".join(
        f"{' '.join(column for column, _ in group)} [{unit}]"
        for unit, group in groupby(units.items(), key=lambda item: item[1])
    )
