"""`testloom calibrate shots` and `rig`: how many impacts a lag takes; figures that accept an overload rig."""

import csv
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from protocol.language import say

AsJson = Annotated[bool, typer.Option("--json", help=say("Print JSON."))]
GUIDE_COLUMNS = ("position_m", "pitch_arcsec", "roll_arcsec")
ARC_SECOND_RAD = math.radians(1.0 / 3600.0)


def shots(
    precision_us: Annotated[float, typer.Option("--precision", help=say("Wanted half width, µs."))] = 25.0,
    frame_us: Annotated[float, typer.Option("--frame", help=say("The gyro's frame period, µs."))] = 500.0,
    level: Annotated[float, typer.Option("--level", help=say("Wanted probability."))] = 0.99,
    instant_error_us: Annotated[
        float, typer.Option("--instant-error", help=say("Largest error of a programmed instant, µs."))
    ] = 0.0,
    as_json: AsJson = False,
) -> None:
    from calibration.algorithms.pure_lag_shots import (
        confidence,
        paper_shots_needed,
        programmed_shots_needed,
        shots_needed,
    )

    precision_s, frame_s = precision_us * 1e-6, frame_us * 1e-6
    needed = shots_needed(precision_s, frame_s, level)
    printed = paper_shots_needed(precision_s, frame_s, level)
    facts: dict[str, Any] = {
        "half_width": needed,
        "mid_point": shots_needed(precision_s, frame_s, level, "mid_point"),
        "programmed": programmed_shots_needed(precision_s, frame_s, instant_error_us * 1e-6),
        "as_printed": printed,
        "as_printed_truly_reaches": confidence(printed, precision_s, frame_s),
    }
    if as_json:
        typer.echo(json.dumps(facts))
        return
    words = (
        ("half_width", say("random impacts until the half width is reached")),
        ("mid_point", say("random impacts until the mid-point is as near")),
        ("programmed", say("impacts at programmed instants, for certain")),
        ("as_printed", say("by paper 3, eq (22), as printed: too few")),
    )
    for key, sentence in words:
        typer.echo(f"{facts[key]:>8}  {sentence}")
    reached = f"{100 * facts['as_printed_truly_reaches']:.1f}"
    typer.echo(say("{shots} shots truly reach it with {percent} %", shots=printed, percent=reached))


def rig(
    recordings: Annotated[
        list[Path] | None, typer.Argument(help=say("Runs of the overload rig: folders or .mcap files."))
    ] = None,
    guide: Annotated[
        Path | None,
        typer.Option(
            "--guide", help=say("A .csv of position_m, pitch_arcsec, roll_arcsec: 30 points or more.")
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    from calibration.algorithms.overload_acceptance import guide_angle, run_figures
    from calibration.evaluations.method_evaluation import stream_with
    from protocol.adapters.recording_forms import read_recording

    facts: dict[str, Any] = {"guide": None, "runs": []}
    if guide is not None:
        position, pitch, roll = _guide_points(guide)
        angles = {"pitch": guide_angle(position, pitch), "roll": guide_angle(position, roll)}
        facts["guide"] = {name: asdict(found) for name, found in angles.items()}
    for path in recordings or []:
        recording = read_recording(path)
        stand = stream_with(recording, "stand", "position")
        figures = run_figures(stand.time_s(), stand.si("position"))
        facts["runs"].append({"recording": recording.recording_id, **asdict(figures)})
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for name, found in (facts["guide"] or {}).items():
        typer.echo(
            say(
                "{name}: largest deviation {largest} arc seconds at {at} m, span {span} arc seconds",
                name=say("pitch") if name == "pitch" else say("roll"),
                largest=f"{found['largest_rad'] / ARC_SECOND_RAD:+.2f}",
                at=f"{found['at_m']:.4f}",
                span=f"{found['span_rad'] / ARC_SECOND_RAD:.2f}",
            )
        )
    for run in facts["runs"]:
        start_up = run["start_up_s"]
        typer.echo(
            say(
                "{recording}: {overload} g, start-up {start_up}, {at_peak} s at the peak, uneven by {uneven}",
                recording=run["recording"],
                overload=f"{run['overload_g']:.4f}",
                start_up=say("not recorded") if start_up is None else f"{start_up:.1f} s",
                at_peak=f"{run['at_peak_s']:.2f}",
                uneven=f"{run['unevenness']:.1e}",
            )
        )


def _guide_points(path: Path) -> tuple[Any, Any, Any]:
    """Positions in m, pitch and roll in rad."""
    import numpy as np

    from protocol.errors import Fault, RecordingError

    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.DictReader(file))
        columns = np.array([[float(line[name]) for name in GUIDE_COLUMNS] for line in lines]).reshape(-1, 3)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RecordingError(
            f"The guide's points cannot be read: {error}.",
            where=str(path),
            fault=Fault.DATA,
            remedy=f"give a .csv with the columns {', '.join(GUIDE_COLUMNS)}.",
        ) from error
    return columns[:, 0], columns[:, 1] * ARC_SECOND_RAD, columns[:, 2] * ARC_SECOND_RAD
