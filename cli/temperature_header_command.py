"""`testloom calibrate header`: a temperature record as a C header for the unit's firmware."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.language import say


def header(
    record: Annotated[Path, typer.Argument(help=say("A calibration record (.json) of the temperature."))],
    out: Annotated[Path, typer.Option("--out", help=say("The header to write, such as acc.h."))],
    name: Annotated[
        str | None, typer.Option("--name", help=say("What its names begin with; else the sensor's name."))
    ] = None,
) -> None:
    from calibration.temperature_header import header_of_record
    from cli.calibration_record_files import read_record
    from protocol.durable_files import storage_error
    from protocol.errors import Fault, TestloomError

    read = read_record(record)
    text = header_of_record(read, name or read.sensor)
    if out.exists() and out.read_text(encoding="ascii", errors="replace") != text:
        raise TestloomError(
            "There is another file of this name already.",
            where=str(out),
            fault=Fault.OPERATOR,
            remedy="choose another name, or take the file away.",
        )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="ascii")
    except OSError as error:
        raise storage_error(error, out) from error
    typer.echo(say("{sensor} of unit {serial}: {target}", sensor=read.sensor, serial=read.serial, target=out))
