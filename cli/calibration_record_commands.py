"""`testloom calibrate` apply, show, compare and history: calibration records put to use."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.help_pages import Command
from cli.rig_commands import rig, shots
from cli.temperature_header_command import header
from protocol.language import say

if TYPE_CHECKING:
    from rich.console import Console

    from calibration.evaluation import Evaluation
    from calibration.evaluations.method_evaluation import MethodEvaluation
    from calibration.records.applying import Compensation
    from calibration.records.comparing import RecordComparison
    from calibration.records.history import QuantityHistory
    from calibration.records.making import Origin
    from calibration.records.record import CalibrationRecord
    from protocol.plans import PlanReference
    from protocol.recordings import Recording

EXIT_REFUSED = 1

AsJson = Annotated[bool, typer.Option("--json", help=say("Print JSON."))]
RecordFile = Annotated[Path, typer.Argument(help=say("A calibration record (.json)."))]


def add_record_commands(app: typer.Typer) -> None:
    """Mount the commands beside the evaluation."""
    for name, command, words in (
        ("apply", apply, say("Compensate a recording of the same unit by a calibration record.")),
        ("show", show, say("Show a calibration record: values, uncertainties, where it comes from.")),
        ("compare", compare, say("Compare two calibration records: which quantities differ.")),
        ("history", history, say("Follow a unit's calibration records over time: drift, outliers.")),
        ("header", header, say("Write a temperature record as a C header for the unit's firmware.")),
        ("shots", shots, say("How many impacts a pure lag takes: random, programmed, and as printed.")),
        ("rig", rig, say("Accept an overload rig: the guide's pitch and roll, how runs come to their peak.")),
    ):
        app.command(name, cls=Command, help=words)(command)


def apply(
    record: RecordFile,
    recording: Annotated[Path, typer.Argument(help=say("The recording: a folder or an .mcap file."))],
    out: Annotated[Path, typer.Option("--out", help=say("What to write: NAME.mcap, or a folder's name."))],
    as_json: AsJson = False,
) -> None:
    from calibration.records.applying import apply_record
    from cli.calibration_record_files import read_record
    from protocol.adapters.mcap_form import write_mcap
    from protocol.adapters.recording_forms import form_of, read_recording
    from protocol.durable_files import storage_error
    from protocol.folder_form import write_folder

    used = read_record(record)
    _refuse_existing(out)
    done = apply_record(used, read_recording(_only_recording(recording)))
    if form_of(out) == "mcap":
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise storage_error(error, out) from error
        write_mcap(done.recording, out)
    else:
        write_folder(done.recording, out)
    warnings = _warnings(used, done)
    if as_json:
        facts = {
            "recording_id": done.recording.recording_id,
            "record_sha256": used.sha256(),
            "target": str(out),
            "samples": done.samples,
            "samples_beyond_valid_temperature": done.beyond_temperature,
            "samples_saturated": done.saturated,
            "warnings": warnings,
        }
        typer.echo(json.dumps(facts, ensure_ascii=False))
        return
    named = {"samples": done.samples, "sensor": used.sensor, "record": used.title, "target": out}
    typer.echo(say("{samples} samples of {sensor} compensated by {record}: {target}", **named))
    for sentence in warnings:
        _console(stderr=True).print(sentence, style="yellow", markup=False, soft_wrap=True)


def show(record: RecordFile, as_json: AsJson = False) -> None:
    from cli.calibration_record_files import read_record
    from cli.calibration_record_pages import show_record

    shown = read_record(record)
    if as_json:
        content = {"sha256": shown.sha256(), "record": json.loads(shown.canonical_json())}
        typer.echo(json.dumps(content, ensure_ascii=False))
    else:
        show_record(_console(), shown)


def compare(first: RecordFile, second: RecordFile, as_json: AsJson = False) -> None:
    from calibration.records.comparing import compare_records
    from cli.calibration_record_files import read_record
    from cli.calibration_record_pages import comparison_remarks, show_comparison

    a, b = read_record(first), read_record(second)
    found = compare_records(a, b)
    if as_json:
        hashes = {"first": a.sha256(), "second": b.sha256()}
        content = hashes | _comparison_json(found) | {"remarks": comparison_remarks(found)}
        typer.echo(json.dumps(content, ensure_ascii=False, allow_nan=False))
    else:
        show_comparison(_console(), a, b, found)


def history(
    paths: Annotated[list[Path], typer.Argument(help=say("Calibration records, or folders of them."))],
    plot: Annotated[Path | None, typer.Option("--plot", help=say("Draw the history into this PNG."))] = None,
    as_json: AsJson = False,
) -> None:
    from calibration.records.history import history_of
    from calibration.records.record import CalibrationRecord
    from cli.calibration_history_plot import write_history_plot
    from cli.calibration_record_files import records_below
    from cli.calibration_record_pages import show_history
    from cli.main import show_error
    from protocol.durable_files import storage_error
    from protocol.errors import Fault, TestloomError

    found = list(records_below(paths))
    records = [one for one in found if isinstance(one, CalibrationRecord)]
    errors = [one for one in found if isinstance(one, TestloomError)]
    for error in errors:
        show_error(error)
    histories = history_of(records)
    if not histories:
        raise TestloomError(
            "There is no calibration record here.",
            where=", ".join(map(str, paths)),
            fault=Fault.OPERATOR,
            remedy="make some with 'testloom calibrate FOLDER --record DIR'.",
        )
    if plot is not None:
        try:
            write_history_plot(histories, plot)
        except OSError as error:
            raise storage_error(error, plot) from error
    if as_json:
        content = {
            "records": len({record.sha256() for record in records}),
            "histories": [_history_json(one) for one in histories],
        }
        typer.echo(json.dumps(content, ensure_ascii=False, allow_nan=False))
    else:
        show_history(_console(), histories)
        if plot is not None:
            typer.echo(str(plot))
    if errors:
        raise typer.Exit(EXIT_REFUSED)


@dataclass(frozen=True)
class Keeping:
    """How records are kept.

    Attributes:
        folder: made if it is not there.
        valid_temperature_c: lowest and highest; None: what the unit had while it was measured.
        plan: a file or the name of one of ours; None: recorded by none.
    """

    folder: Path
    valid_temperature_c: tuple[float, float] | None = None
    plan: str | None = None


def keep_records(
    evaluation: "Evaluation", sources: "Sequence[tuple[Recording, Path]]", keeping: Keeping
) -> list[tuple["CalibrationRecord", Path]]:
    """Write the records of an evaluation; what was written.

    Args:
        evaluation: with its sentences in English.
        sources: its recordings, and where they were read from.
        keeping: where and with what.
    """
    from calibration.records.making import records_of
    from cli.calibration_record_files import write_record

    origin = _origin(evaluation.product, sources, keeping)
    made = records_of(evaluation, [recording for recording, _ in sources], origin)
    return [(record, write_record(record, keeping.folder)) for record in made]


def keep_method_records(
    evaluation: "MethodEvaluation", sources: "Sequence[tuple[Recording, Path]]", keeping: Keeping
) -> list[tuple["CalibrationRecord", Path]]:
    """As `keep_records`, a record for each sensor, from the recordings that it rests on."""
    from calibration.records.making import record_of
    from cli.calibration_record_files import write_record

    made: list[CalibrationRecord] = []
    for result in evaluation.results:
        mine = [source for source in sources if any(source[0] is one for one in result.recordings)]
        origin = _origin(evaluation.product, mine, keeping)
        made.append(record_of(result.content, result.sensor, result.recordings, origin))
    return [(record, write_record(record, keeping.folder)) for record in made]


def _origin(product: str, sources: "Sequence[tuple[Recording, Path]]", keeping: Keeping) -> "Origin":
    from calibration.records.making import Origin
    from calibration.records.record_parts import TemperatureSpan
    from cli.calibration_record_files import code_version, now, source_of

    span = None
    if keeping.valid_temperature_c is not None:
        low_c, high_c = keeping.valid_temperature_c
        span = TemperatureSpan(low_c=low_c, high_c=high_c)
    return Origin(
        recordings=tuple(source_of(recording.recording_id, path) for recording, path in sources),
        code=code_version(),
        created_at=now(),
        plan=None if keeping.plan is None else _plan(keeping.plan, product),
        valid_temperature=span,
    )


def _plan(named: str, product: str) -> "PlanReference":
    from protocol.errors import Fault, PlanError
    from stations.sequencing.step_registry import bundled_plans, load_plan

    bundled = bundled_plans()
    plan = bundled[named] if named in bundled else load_plan(Path(named))
    if plan.product != product:
        raise PlanError(
            f"The plan is of the product '{plan.product}', the recording of '{product}'.",
            where=named,
            fault=Fault.OPERATOR,
            remedy="name the plan that it was recorded by.",
        )
    return plan.reference()


def _warnings(record: "CalibrationRecord", done: "Compensation") -> list[str]:
    valid, warnings = record.valid_temperature, list[str]()
    if done.beyond_temperature is None:
        warnings.append(
            say("Whether the record holds at this temperature is not known: recording or record has none.")
        )
    elif done.beyond_temperature and valid is not None:
        warnings.append(
            say(
                "{count} of {samples} samples lie outside the record's valid range of {low} to {high} °C: "
                "they are compensated, and not to be relied on.",
                count=done.beyond_temperature,
                samples=done.samples,
                low=f"{valid.low_c:.1f}",
                high=f"{valid.high_c:.1f}",
            )
        )
    if done.saturated:
        warnings.append(
            say(
                "{count} of {samples} samples were saturated: what they compensate to is wrong.",
                count=done.saturated,
                samples=done.samples,
            )
        )
    if record.stand is not None and record.stand.calibration_overdue:
        warnings.append(say("The stand's own calibration was overdue when the record was measured."))
    return warnings


def _only_recording(path: Path) -> Path:
    """The recording at a path, or the one that a folder of recordings holds."""
    from protocol.adapters.recording_forms import recordings_below
    from protocol.errors import Fault, RecordingError

    found = recordings_below(path)
    if len(found) > 1:
        raise RecordingError(
            f"{len(found)} recordings lie in this folder, and one is compensated at a time.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy=f"name one of them, such as {found[0]}.",
        )
    return found[0]


def _refuse_existing(out: Path) -> None:
    from protocol.errors import Fault, RecordingError

    if out.exists():
        raise RecordingError(
            "There is something of this name already.",
            where=str(out),
            fault=Fault.OPERATOR,
            remedy="choose another name, or move it away.",
        )


def _comparison_json(found: "RecordComparison") -> dict[str, Any]:
    quantities: list[dict[str, Any]] = []
    for one in found.quantities:
        facts = asdict(one) | {"significant": one.significant}
        for name in ("zeta", "normalised_error"):
            facts[name] = facts[name] if math.isfinite(facts[name]) else None
        quantities.append(facts)
    return {
        "quantities": quantities,
        "chi_square": found.chi_square,
        "degrees_of_freedom": found.degrees_of_freedom,
        "probability": found.probability,
        "significant": list(found.significant),
        "not_compared": list(found.not_compared),
        "shared_recordings": list(found.shared_recordings),
    }


def _history_json(one: "QuantityHistory") -> dict[str, Any]:
    return {
        "product": one.product,
        "serial": one.serial,
        "sensor": one.sensor,
        "quantity": one.name,
        "unit": one.unit,
        "points": [asdict(point) | {"time": point.time.isoformat()} for point in one.points],
        "trend": asdict(one.trend) | {"drifts": one.trend.drifts},
    }


def _console(*, stderr: bool = False) -> "Console":
    from rich.console import Console

    return Console(highlight=False, markup=False, stderr=stderr)
