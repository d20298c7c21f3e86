"""`testloom gap`: the simulator against recordings: where they differ, why, and how far it closes."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.help_pages import Command, Group
from protocol.language import say

if TYPE_CHECKING:
    from gap_diagnosis.report import GapReport
    from gap_diagnosis.report_document import ReportDocument

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help=say("The simulator against recordings: where they differ, why, and how far it closes."),
)

Recordings = Annotated[
    list[Path], typer.Argument(help=say("Recordings: folders, folders of such folders, or .mcap files."))
]
Report = Annotated[Path, typer.Argument(help=say("A gap report: report.json, or the folder that it is in."))]
AsJson = Annotated[bool, typer.Option("--json", help=say("Print JSON."))]
STEPS = {
    "reading": "reading recordings",
    "columns": "preparing effects",
    "where": "where the gap lies",
    "which": "which effect causes it",
    "how large": "how large it is",
    "held out": "held-out data",
    "what is left": "what is left",
    "next test": "the next test",
    "report": "writing the report",
    "units": "diagnosing units",
    "mounts": "each mount by itself",
}
"""What the diagnosis tells of its progress → words."""


@app.command(
    cls=Command,
    help=say("Diagnose recordings of one unit: report.json, report.html and plots in one folder."),
)
def diagnose(
    recordings: Recordings,
    out: Annotated[Path, typer.Option("--out", help=say("The folder for the report."))],
    as_json: AsJson = False,
    without: Annotated[
        list[str] | None,
        typer.Option(
            "--without", help=say("An effect that is not to be offered; may be given several times.")
        ),
    ] = None,
) -> None:
    from cli.emulator_values import check_effect_name
    from cli.gap_recordings import named_recordings
    from dut_emulator.recording.recording_files import refuse_existing
    from gap_diagnosis.diagnosis import diagnose as diagnosed
    from gap_diagnosis.report_document import parse_report, report_text

    for name in without or []:
        check_effect_name(name)
    for name in ("report.json", "report.html", "plots"):
        refuse_existing(out / name)
    with _progress() as tell:
        tell("reading", 0.0)
        named = named_recordings(recordings)
        report = diagnosed([one.recording for one in named], without=frozenset(without or []), progress=tell)
        text = report_text({**report.document, "recordings": [one.entry() for one in named]})
        document = parse_report(text)
        tell("report", 0.98)
        write_report(report, document, text, out)
    if as_json:
        typer.echo(text, nl=False)
    else:
        _show(document, out)


@app.command(
    cls=Command,
    help=say(
        "Many units on several stands: which causes are the unit's, the lot's, the stand's or the link's."
    ),
)
def cohort(
    recordings: Recordings,
    out: Annotated[
        Path, typer.Option("--out", help=say("The folder for all reports; what is finished there is kept."))
    ],
    workers: Annotated[
        int, typer.Option("--workers", min=1, max=64, help=say("Processes that work side by side."))
    ] = 2,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler", help=say("A Dask scheduler on this machine instead: tcp://127.0.0.1:8786.")
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    from rich.console import Console

    from cli.cohort_runs import cohort_of
    from cli.cohort_tables import cohort_document, cohort_view
    from gap_diagnosis.cohort_page import cohort_html
    from protocol.durable_files import write_whole

    with _progress() as tell:
        found = cohort_of(recordings, out, workers, scheduler, tell)
        tell("report", 0.96)
        document = cohort_document(found)
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        write_whole(out / "cohort.html", cohort_html(found.findings, document))
        write_whole(out / "cohort.json", text)
    if as_json:
        typer.echo(text, nl=False)
    else:
        Console(highlight=False).print(cohort_view(found))
        typer.echo(str(out / "cohort.html"))


@app.command(cls=Command, help=say("Add the effects that a report found to a twin file."))
def apply(
    report: Report,
    twin: Annotated[Path, typer.Option("--twin", help=say("The twin file of the simulator."))],
    out: Annotated[
        Path | None,
        typer.Option("--out", help=say("The new twin file; beside the old one if left out.")),
    ] = None,
    rank: Annotated[
        int,
        typer.Option("--rank", help=say("Which of the report's sets of effects; 1 is the most probable.")),
    ] = 1,
) -> None:
    from rich.console import Console

    from cli.emulator_commands import check_product_can_have
    from cli.gap_tables import changes_table
    from dut_emulator.recording.recording_files import refuse_existing
    from dut_emulator.twin import read_twin, write_twin
    from gap_diagnosis.report_document import read_report
    from gap_diagnosis.report_words import class_members, set_words
    from gap_diagnosis.twin_change import twin_with_found

    target = out or twin.with_name(f"{twin.stem}-with-gap.json")
    refuse_existing(target)
    found = read_report(report)
    change = twin_with_found(read_twin(twin), found, str(report), rank)
    check_product_can_have(change.twin)
    write_twin(change.twin, target)
    console = Console(highlight=False)
    console.print(changes_table(change.changes))
    if found.verdict == "confusable":
        others = [set_words(one.effects) for one in class_members(found)]
        words = say(
            "The report could not tell these apart: {names}. The new twin is right where it was tested.",
            names="; ".join(others),
        )
        Console(stderr=True, highlight=False).print(words, style="yellow", markup=False)
    typer.echo(str(target))


@app.command(
    cls=Command, help=say("How much of the gap is left on recordings that the report was not made from.")
)
def verify(report: Report, recordings: Recordings, as_json: AsJson = False) -> None:
    from rich.console import Console

    from cli.gap_recordings import named_recordings, refuse_used
    from cli.gap_tables import verification_view
    from gap_diagnosis.decimation import decimated
    from gap_diagnosis.report_document import Shrinkage, read_report
    from gap_diagnosis.twin_change import found_effects
    from gap_diagnosis.verification import verify as verified
    from gap_diagnosis.without_stand import observed_together

    found = read_report(report)
    effects = [one.effect for one in found_effects(found, str(report))]
    with _progress() as tell:
        tell("reading", 0.0)
        named = named_recordings(recordings)
        refuse_used(named, found)
        observations = []
        for number, one in enumerate(named):
            beside, by_norm = observed_together([one.recording], lambda _share: None)
            observations += [*map(decimated, beside), *by_norm]
            tell("reading", 0.6 * (number + 1) / len(named))
        tell("held out", 0.6)
        left = verified(observations, effects)
    if as_json:
        typer.echo(json.dumps(left, ensure_ascii=False, allow_nan=False))
        return
    shrinkage = Shrinkage.model_validate_json(json.dumps(left, allow_nan=False))
    Console(highlight=False).print(verification_view(shrinkage))
    if not found.recordings:
        typer.echo(say("The report does not say what it was made from: whether these are new is not known."))


@app.command("next", cls=Command, help=say("The next test of a report, and the command that makes it."))
def next_test(report: Report) -> None:
    from cli.gap_orders import ways_to_test
    from gap_diagnosis.report_document import read_report
    from gap_diagnosis.report_words import set_words

    found = read_report(report)
    test = found.next_test
    if test is None:
        typer.echo(say("No test of this product's promises to tell more."))
        return
    told = {"profile": test.profile, "minutes": f"{test.minutes:.3g}", "bits": f"{test.expected_bits:.2f}"}
    typer.echo(say("{profile}, {minutes} min: {bits} bits of information expected.", **told))
    for name in test.separates:
        typer.echo(f"  · {set_words(tuple(part for part in name.split(' + ') if part))}")
    for line in ways_to_test(found, test):
        typer.echo(line)


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal's standard error; nothing where nobody looks."""
    from rich.console import Console
    from rich.progress import Progress

    errors = Console(stderr=True)
    with Progress(console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(say("reading recordings"), total=1.0)

        def tell(step: str, share: float) -> None:
            bar.update(task, completed=share, description=say(STEPS[step]) if step in STEPS else step)

        yield tell


def write_report(report: "GapReport", document: "ReportDocument", text: str, out: Path) -> None:
    """report.json, report.html and plots into a folder."""
    from gap_diagnosis.report_page import report_html
    from gap_diagnosis.report_pictures import pictures
    from protocol.durable_files import write_whole

    drawn = pictures(report)
    for one in drawn:
        write_whole(out / "plots" / one.file_name, one.svg + "\n")
    write_whole(out / "report.html", report_html(report, document, drawn))
    write_whole(out / "report.json", text)


def _show(document: "ReportDocument", out: Path) -> None:
    from cli.gap_tables import report_view

    console: Any = _console()
    console.print(report_view(document))
    typer.echo(str(out / "report.html"))


def _console() -> Any:
    from rich.console import Console

    return Console(highlight=False)
