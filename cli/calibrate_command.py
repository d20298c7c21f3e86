"""`testloom calibrate`: coefficients with standard uncertainties from recordings of real sensors.

`testloom calibrate FOLDER…` evaluates; the words apply, show, compare and history go on with records.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.evaluation import Evaluation
from calibration.evaluations.by_profile import evaluate_by_profile, has_method
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.published import ComparedReference, compare_magnetometer, compare_with_published
from calibration.recorded import Source, evaluate, together
from calibration.records.record import CalibrationRecord
from cli.calibration_record_commands import (
    EXIT_REFUSED,
    Keeping,
    add_record_commands,
    keep_method_records,
    keep_records,
)
from cli.help_pages import Command, Group
from cli.method_evaluation_pages import method_evaluation_json, show_method_evaluation
from cli.published_pages import reference_json, show_reference
from cli.uncertain_numbers import gum
from protocol.adapters.recording_forms import read_recording
from protocol.errors import Fault, RecordingError, TestloomError
from protocol.language import choose_language, chosen_language, say, translated
from protocol.recording_document import DOCUMENT_NAME

FORMAT = "testloom-calibration/1"
MAX_RECORDINGS = 1000
MAX_RESIDUALS_SHOWN = 12
EVALUATE = "evaluate"
METHOD_WORDS = {
    "imu_calibration": "session on a stand: known poses and turns",
    "ferraris": "Ferraris session by hand",
    "multi_position": "many attitudes, unknown: only the magnitude of gravity is used",
}


@dataclass(frozen=True)
class _Located(Source):
    """A source that knows which path was named: its bytes are the recording's identity."""

    path: Path = Path()


@dataclass(frozen=True)
class _Result:
    """One group of recordings: evaluated, or refused with an error."""

    names: str
    evaluation: Evaluation | MethodEvaluation | None = None
    reference: ComparedReference | None = None
    error: TestloomError | None = None
    kept: tuple[tuple[CalibrationRecord, Path], ...] = ()


class EvaluateByDefault(Group):
    """`calibrate FOLDER…` is `calibrate evaluate FOLDER…`; a folder named as a command is ./show."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = [EVALUATE, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=EvaluateByDefault,
    no_args_is_help=True,
    help=say("Calibrate from recordings, and use calibration records; 'evaluate' may be left out."),
)


@app.command(
    EVALUATE,
    cls=Command,
    help=say("Calibrate from recordings: coefficients, uncertainties, what was not used and why."),
)
def calibrate(
    folders: Annotated[
        list[Path],
        typer.Argument(help=say("Recordings: folders, folders of such folders, or .mcap files.")),
    ],
    as_json: Annotated[bool, typer.Option("--json", help=say("Print JSON."))] = False,
    record: Annotated[
        Path | None, typer.Option("--record", help=say("Write calibration records into this folder."))
    ] = None,
    valid_temperature_c: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--valid-temperature",
            help=say("Where the records hold, °C; else the temperatures that the unit had."),
        ),
    ] = None,
    plan: Annotated[
        str | None, typer.Option("--plan", help=say("The plan it was recorded by: a file, or one of ours."))
    ] = None,
) -> None:
    _refuse_crossed(valid_temperature_c)
    keeping = None if record is None else Keeping(record, valid_temperature_c, plan)
    sources, results = _read_all(folders)
    for group in together(sources):
        names = ", ".join(source.recording.recording_id for source in group)
        try:
            results.append(_evaluated(names, group, keeping))
        except TestloomError as error:
            results.append(_Result(names, error=error))
    if as_json:
        document = {"format": FORMAT, "results": [_as_json(result) for result in results]}
        typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False))
    else:
        console = Console(highlight=False, markup=False)
        for result in results:
            _show(console, result)
    if any(result.error for result in results):
        raise typer.Exit(EXIT_REFUSED)


add_record_commands(app)


def _evaluated(names: str, group: tuple[_Located, ...], keeping: Keeping | None) -> _Result:
    by_profile = has_method(group[0].recording)
    kept: tuple[tuple[CalibrationRecord, Path], ...] = ()
    evaluation: Evaluation | MethodEvaluation
    if keeping is None:
        evaluation = _by_method(group) if by_profile else evaluate(group)
    else:
        language = chosen_language()
        choose_language("en")  # a record says the same whoever reads it
        try:
            read_from = [(source.recording, source.path) for source in group]
            if by_profile:
                evaluation = _by_method(group)
                kept = tuple(keep_method_records(evaluation, read_from, keeping))
            else:
                evaluation = evaluate(group)
                kept = tuple(keep_records(evaluation, read_from, keeping))
        finally:
            choose_language(language)
    if isinstance(evaluation, MethodEvaluation):
        return _Result(names, evaluation, compare_magnetometer(evaluation, group[0].folder), kept=kept)
    reference = compare_with_published(evaluation, group[0].recording, group[0].folder)
    return _Result(names, evaluation, reference, kept=kept)


def _by_method(group: tuple[_Located, ...]) -> MethodEvaluation:
    return evaluate_by_profile([source.recording for source in group])


def _refuse_crossed(valid_temperature_c: tuple[float, float] | None) -> None:
    if valid_temperature_c is None:
        return
    low_c, high_c = valid_temperature_c
    if not -math.inf < low_c <= high_c < math.inf:
        raise TestloomError(
            "The valid range of temperature ends below its beginning.",
            where="--valid-temperature",
            fault=Fault.OPERATOR,
            remedy="give the lowest temperature first.",
        )


def _read_all(paths: list[Path]) -> tuple[list[_Located], list[_Result]]:
    """All recordings named, and a refusal for each that cannot be read."""
    found: list[Path] = []
    for path in paths:
        inside = sorted(child.parent for child in path.glob(f"*/{DOCUMENT_NAME}")) if path.is_dir() else []
        found += [path] if (path / DOCUMENT_NAME).exists() or not inside else inside
    if len(found) > MAX_RECORDINGS:
        raise RecordingError(
            f"{len(found)} recordings are more than {MAX_RECORDINGS}.",
            where=", ".join(str(path) for path in paths),
            fault=Fault.OPERATOR,
            remedy="calibrate them in parts.",
        )
    sources: list[_Located] = []
    refused: list[_Result] = []
    for path in found:
        try:
            sources.append(_Located(read_recording(path), path if path.is_dir() else path.parent, path))
        except TestloomError as error:
            refused.append(_Result(str(path), error=error))
    _refuse_twice(sources)
    return sources, refused


def _refuse_twice(sources: list[_Located]) -> None:
    """The same samples twice, also of a copy: uncertainties would be too small by a root of two."""
    seen: dict[bytes, Path] = {}
    for source in sources:
        told = json.dumps(source.recording.test, sort_keys=True, default=str)
        digest = hashlib.sha256(told.encode())
        for name, stream in sorted(source.recording.streams.items()):
            for column, values in sorted(stream.columns.items()):
                digest.update(f"{name}.{column}".encode())
                digest.update(np.ascontiguousarray(values).tobytes())
        first = seen.setdefault(digest.digest(), source.path)
        if first is not source.path:
            raise RecordingError(
                "The same recording is named twice: its samples would count as two measurements.",
                where=f"{first}, {source.path}",
                fault=Fault.OPERATOR,
                remedy="name each recording once.",
            )


def _show(console: Console, result: _Result) -> None:
    console.rule(Text(result.names))
    if result.error is not None:
        from cli.main import show_error

        show_error(result.error)
        return
    evaluation = result.evaluation
    assert evaluation is not None
    if isinstance(evaluation, MethodEvaluation):
        show_method_evaluation(console, evaluation)
        show_reference(console, result.reference)
    else:
        _show_triads(console, evaluation, result.reference)
    _show_not_used(console, evaluation)
    for record, path in result.kept:
        console.print(say("record {record}: {path}", record=record.title, path=path), soft_wrap=True)


def _show_triads(console: Console, evaluation: Evaluation, reference: ComparedReference | None) -> None:
    console.print(
        say("Unit {serial} ({product})", serial=evaluation.serial, product=evaluation.product), style="bold"
    )
    console.print(say("Method: {method}", method=say(METHOD_WORDS[evaluation.method])))
    for sentence in evaluation.assumptions:
        console.print(f"  · {translated(sentence)}")
    for name, triad in ((say("Accelerometer"), evaluation.acc), (say("Gyro"), evaluation.gyro)):
        if triad is not None:
            console.print(_triad_table(name, triad))
    if evaluation.gyro_bias is not None:
        bias = evaluation.gyro_bias
        table = Table("", "x", "y", "z", header_style="bold", title=say("Gyro bias at rest, rad/s"))
        figures = zip(bias.bias_rad_s, bias.standard_uncertainty_rad_s, strict=True)
        table.add_row("b", *(gum(float(b), float(u)) for b, u in figures))
        console.print(table)
    _show_residuals(console, evaluation)
    show_reference(console, reference)


def _triad_table(name: str, triad: TriadCoefficients) -> Table:
    table = Table(
        header_style="bold",
        title=say("{name}: y = M u + b, value ± standard uncertainty", name=name),
        caption=say(
            "residual {rms} {unit} rms, {freedom} degrees of freedom; compensate with u = inv(M) (y − b)",
            rms=f"{triad.residual_rms:.2g}",
            unit=triad.unit,
            freedom=triad.degrees_of_freedom,
        ),
    )
    for heading in ("", "M · x", "M · y", "M · z", f"b, {triad.unit}"):
        table.add_column(heading)
    uncertainty, bias_uncertainty = triad.matrix_standard_uncertainty(), triad.bias_standard_uncertainty()
    for i, axis in enumerate("xyz"):
        entries = [gum(float(triad.matrix[i, j]), float(uncertainty[i, j])) for j in range(3)]
        table.add_row(axis, *entries, gum(float(triad.bias[i]), float(bias_uncertainty[i])))
    return table


def _show_residuals(console: Console, evaluation: Evaluation) -> None:
    worst = sorted(evaluation.residuals, key=lambda r: (r.unit, -max(map(abs, r.values), default=0.0)))
    table = Table(header_style="bold", title=say("Residuals (output less model), largest first"))
    for heading in (say("Pose or turn"), say("Residual"), say("Unit")):
        table.add_column(heading)
    for unit in sorted({residual.unit for residual in worst}):
        of_unit = [residual for residual in worst if residual.unit == unit]
        for residual in of_unit[:MAX_RESIDUALS_SHOWN]:
            table.add_row(residual.name, "  ".join(f"{value:+.2e}" for value in residual.values), unit)
        if len(of_unit) > MAX_RESIDUALS_SHOWN:
            table.add_row(say("{count} smaller ones", count=len(of_unit) - MAX_RESIDUALS_SHOWN), "…", unit)
    if evaluation.residuals:
        console.print(table)


def _show_not_used(console: Console, evaluation: Evaluation | MethodEvaluation) -> None:
    if not evaluation.not_used:
        console.print(say("Everything in the data was used."))
        return
    table = Table(header_style="bold", title=say("Not used, and why"))
    for heading in (say("What"), say("Samples"), say("Why")):
        table.add_column(heading, overflow="fold")
    for item in evaluation.not_used:
        table.add_row(translated(item.what), str(item.count), translated(item.why))
    console.print(table)


def _as_json(result: _Result) -> dict[str, Any]:
    if result.error is not None:
        error = result.error
        return {
            "recordings": result.names.split(", "),
            "error": {
                "what": error.what,
                "where": error.where,
                "fault": error.fault.value,
                "remedy": error.remedy,
            },
        }
    evaluation = result.evaluation
    assert evaluation is not None
    records = [
        {"sensor": record.sensor, "sha256": record.sha256(), "path": str(path)}
        for record, path in result.kept
    ]
    if isinstance(evaluation, MethodEvaluation):
        published = None if result.reference is None else reference_json(result.reference)
        return method_evaluation_json(evaluation) | {"published": published, "records": records}
    bias = evaluation.gyro_bias
    return {
        "recordings": list(evaluation.recording_ids),
        "unit": {"serial": evaluation.serial, "product": evaluation.product},
        "method": evaluation.method,
        "acc": None if evaluation.acc is None else _triad_json(evaluation.acc),
        "gyro": None if evaluation.gyro is None else _triad_json(evaluation.gyro),
        "gyro_bias": None
        if bias is None
        else {
            "unit": "rad/s",
            "value": _list(bias.bias_rad_s),
            "standard_uncertainty": _list(bias.standard_uncertainty_rad_s),
            "degrees_of_freedom": bias.degrees_of_freedom,
        },
        "residuals": [
            {"name": r.name, "values": list(r.values), "unit": r.unit} for r in evaluation.residuals
        ],
        "assumptions": list(evaluation.assumptions),
        "not_used": [
            {"what": item.what, "count": item.count, "why": item.why} for item in evaluation.not_used
        ],
        "published": None if result.reference is None else reference_json(result.reference),
        "records": records,
    }


def _triad_json(triad: TriadCoefficients) -> dict[str, Any]:
    return {
        "model": "y = M u + b",
        "unit": triad.unit,
        "matrix": _list(triad.matrix),
        "matrix_standard_uncertainty": _list(triad.matrix_standard_uncertainty()),
        "bias": _list(triad.bias),
        "bias_standard_uncertainty": _list(triad.bias_standard_uncertainty()),
        "compensation": _list(triad.compensation),
        "covariance": _list(triad.covariance),
        "nonorthogonality_rad": _list(triad.nonorthogonality_rad()),
        "residual_rms": triad.residual_rms,
        "degrees_of_freedom": triad.degrees_of_freedom,
    }


def _list(array: FloatArray) -> Any:
    return np.asarray(array).tolist()
