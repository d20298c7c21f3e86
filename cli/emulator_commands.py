"""`testloom emulator`: record emulated units on emulated stands, look at what they are made of."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.help_pages import Command, Group
from protocol.language import say, translated

if TYPE_CHECKING:
    from dut_emulator.recording.recorder import RecordingSession
    from dut_emulator.twin import Twin

app = typer.Typer(
    cls=Group, no_args_is_help=True, help=say("Emulated units on emulated stands: record and look at them.")
)


def _option(name: str, help_text: str) -> Any:
    return typer.Option(f"--{name}", help=help_text)


Form = Literal["both", "folder", "mcap"]
Files = Literal["npz", "csv", "parquet"]
Seed = Annotated[int, _option("seed", say("Seed of the lot that the unit comes from, and of its noise."))]
Serial = Annotated[str, _option("serial", say("Serial number: which unit of the lot."))]
TwinFile = Annotated[
    Path | None, _option("twin", say("A twin file: the unit's true effects, instead of drawn ones."))
]
Sets = Annotated[
    list[str] | None,
    _option("set", say("A parameter of the profile, such as dwell_s=2s; may be given several times.")),
]
StandSeed = Annotated[int, _option("stand-seed", say("Which stand of its kind."))]
Run = Annotated[int, _option("run", say("Number of the run; each has noise of its own."))]
Mount = Annotated[str, _option("mount", say("Name of the mounting; another one turns the unit a little."))]
PoweredBefore = Annotated[
    float, _option("powered-before", say("Seconds that the unit has been powered before the run."))
]
NoTrigger = Annotated[
    bool, _option("no-trigger", say("Start the clocks of unit and stand without a common edge."))
]
ClockOffset = Annotated[
    float, _option("clock-offset", say("How far the stand's clock is ahead without a trigger, in s."))
]
StartedAt = Annotated[str, _option("started-at", say("Date and time of the run."))]
WrittenForm = Annotated[Form, _option("form", say("Which forms are written."))]
StreamFiles = Annotated[
    Files, _option("stream-format", say("Files of a folder's streams: npz, csv or parquet."))
]
Rate = Annotated[float | None, _option("rate", say("Samples per second, instead of the product's own rate."))]
Float32 = Annotated[bool, _option("float32", say("Samples as 32-bit numbers; times stay 64-bit."))]
Truth = Annotated[
    Path | None, _option("truth", say("Write the true effects of unit and stand into this file."))
]
Latitude = Annotated[float, _option("latitude", say("Latitude of the site in degrees."))]
Gravity = Annotated[float, _option("gravity", say("Gravity at the site in m/s^2."))]
Heading = Annotated[
    float, _option("heading", say("Azimuth of the stand's y axis in degrees, east of north."))
]
AsJson = Annotated[bool, _option("json", say("Print JSON."))]
UnitOrFile = Annotated[str, typer.Argument(help=say("A product, whose unit is drawn, or a twin file."))]


@app.command(cls=Command, help=say("Record one run of a profile, as MCAP and as a folder."))
def record(
    product: Annotated[str, typer.Argument(help=say("Which product; see 'testloom emulator products'."))],
    profile: Annotated[str, typer.Argument(help=say("Which profile; see 'testloom emulator products'."))],
    out: Annotated[Path, _option("out", say("Where the recording is put."))],
    settings: Sets = None,
    twin: TwinFile = None,
    seed: Seed = 1,
    serial: Serial = "U-0001",
    stand_seed: StandSeed = 1,
    run: Run = 1,
    mount: Mount = "m1",
    powered_before_s: PoweredBefore = 0.0,
    no_trigger: NoTrigger = False,
    clock_offset_s: ClockOffset = 0.013,
    started_at: StartedAt = "2026-01-01T00:00:00Z",
    form: WrittenForm = "both",
    stream_format: StreamFiles = "npz",
    rate: Rate = None,
    float32: Float32 = False,
    truth: Truth = None,
    latitude: Latitude = 39.96,
    gravity: Gravity = 9.8013,
    heading: Heading = 0.0,
    as_json: AsJson = False,
) -> None:
    from cli.emulator_values import profile_values
    from dut_emulator.motion.profile_catalogue import profile_named
    from dut_emulator.recording.order import RecordingOrder
    from dut_emulator.recording.recorder import RecordingSession

    order = RecordingOrder(
        product,
        profile,
        values=profile_values(profile_named(profile), settings or []),
        twin=_twin_in(twin) if twin else None,
        seed=seed,
        serial=serial,
        stand_seed=stand_seed,
        site=_site(latitude, gravity, heading),
        triggered=not no_trigger,
        clock_offset_s=clock_offset_s,
        run=run,
        mount=mount,
        powered_before_s=powered_before_s,
        started_at=started_at,
        sample_type="float32" if float32 else "float64",
        rate_hz=rate,
    )
    _write(RecordingSession(order), out, form, stream_format, truth, as_json=as_json)


@app.command(cls=Command, help=say("List the products, and the profiles and stands that each is tested on."))
def products(
    profile: Annotated[str | None, typer.Argument(help=say("A profile, to see its parameters."))] = None,
    as_json: AsJson = False,
) -> None:
    from cli.emulator_tables import products_table, profile_table
    from dut_emulator.motion.profile_catalogue import profile_named
    from dut_emulator.products.catalogue import PRODUCTS, product_named

    if profile is not None:
        kind = profile_named(profile)
        if as_json:
            typer.echo(json.dumps(asdict(kind), ensure_ascii=False))
        else:
            _console().print(profile_table(kind))
        return
    known = [product_named(name) for name in PRODUCTS]
    if as_json:
        pairs = {one.name: {name: asdict(at) for name, at in one.profiles.items()} for one in known}
        typer.echo(json.dumps(pairs))
    else:
        _console().print(products_table(known))


@app.command(cls=Command, help=say("Show the true effects of a unit, with their parameters."))
def show(
    unit: UnitOrFile,
    seed: Seed = 1,
    serial: Serial = "U-0001",
    out: Annotated[Path | None, _option("out", say("Write the unit's twin file."))] = None,
) -> None:
    from cli.emulator_tables import twin_table

    twin = _twin_of(unit, seed, serial)
    if out is None:
        _console().print(twin_table(twin, unit))
    else:
        _keep(twin, out)


@app.command(cls=Command, help=say("List the effects, or show one in full."))
def effects(
    name: Annotated[str | None, typer.Argument(help=say("An effect, such as gyro.g_sensitivity."))] = None,
) -> None:
    from cli.emulator_tables import catalogue_table, effect_page

    _console().print(catalogue_table() if name is None else effect_page(name))


@app.command("with", cls=Command, help=say("Give a unit one effect more, or other parameters of one it has."))
def with_one_more(
    unit: UnitOrFile,
    effect: Annotated[str, typer.Argument(help=say("An effect, such as gyro.g_sensitivity."))],
    out: Annotated[Path, _option("out", say("Write the unit's twin file."))],
    parameters: Annotated[
        list[str] | None,
        typer.Argument(
            help=say("Its parameters, such as bias_si_x=5deg/h; without a unit, SI as in the catalogue.")
        ),
    ] = None,
    sensor: Annotated[
        Literal["gyro", "acc", "mag"] | None, _option("sensor", say("Which triad, where it is left open."))
    ] = None,
    axis: Annotated[
        str | None, _option("axis", say("The stand's axis that the effect follows: outer, middle or inner."))
    ] = None,
    seed: Seed = 1,
    serial: Serial = "U-0001",
) -> None:
    from cli.emulator_values import with_effect

    twin = with_effect(_twin_of(unit, seed, serial), effect, sensor, axis, parameters or [])
    check_product_can_have(twin)
    _keep(twin, out)


@app.command(
    cls=Command, help=say("Draw a unit's Allan deviations, errors over temperature, answer to a step.")
)
def plot(
    unit: UnitOrFile,
    out: Annotated[Path, _option("out", say("The folder for the pictures."))],
    seed: Seed = 1,
    serial: Serial = "U-0001",
) -> None:
    from cli.emulator_plots import unit_to_draw, write_plots
    from dut_emulator.products.catalogue import product_named

    twin = _twin_of(unit, seed, serial)
    product = product_named(twin.product)
    name = f"{product.name}-{serial}" if unit == product.name else Path(unit).stem
    for path in write_plots(unit_to_draw(twin, name, product), out):
        typer.echo(str(path))


def check_product_can_have(twin: "Twin") -> None:
    """What a bench or a recording would refuse later is refused before the file is there."""
    from dut_emulator.products.catalogue import product_named
    from dut_emulator.recording.order import RecordingOrder
    from dut_emulator.recording.recorder import RecordingSession

    if twin.product:
        profile = next(iter(product_named(twin.product).profiles))
        RecordingSession(RecordingOrder(twin.product, profile, twin=twin))


def _console() -> Any:
    from rich.console import Console

    return Console(highlight=False)


def _site(latitude_deg: float, gravity_m_s2: float, heading_deg: float) -> Any:
    from pydantic import ValidationError

    from protocol.bench_description import Site
    from protocol.errors import Fault, TestloomError

    try:
        return Site(latitude_deg=latitude_deg, gravity_m_s2=gravity_m_s2, heading_deg=heading_deg)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise TestloomError(
            f"There is no such site: {first['loc'][0]}, {first['msg']}.",
            where="site",
            fault=Fault.OPERATOR,
            remedy="give latitude in degrees and gravity in m/s^2.",
        ) from error


def _twin_in(path: Path) -> "Twin":
    from dut_emulator.twin import read_twin

    return read_twin(path)


def _twin_of(unit: str, seed: int, serial: str) -> "Twin":
    """Of a product's unit, else of a file."""
    from dut_emulator.products.catalogue import PRODUCTS, product_named
    from dut_emulator.recording.order import check_unit
    from protocol.errors import Fault, TestloomError

    if unit in PRODUCTS:
        check_unit(seed, serial)
        return product_named(unit).twin(seed, serial)
    if not Path(unit).exists():
        raise TestloomError(
            f"'{unit}' is neither a product nor a twin file.",
            where="command line",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(PRODUCTS)}, or the name of a file.",
        )
    return _twin_in(Path(unit))


def _keep(twin: "Twin", out: Path) -> None:
    """A twin file, and what is in it; nothing is written over."""
    from cli.emulator_tables import twin_table
    from dut_emulator.recording.recording_files import refuse_existing
    from dut_emulator.twin import write_twin

    refuse_existing(out)
    write_twin(twin, out)
    _console().print(twin_table(twin, str(out)))


def _write(
    session: "RecordingSession",
    out: Path,
    form: Form,
    stream_format: Files,
    truth: Path | None,
    *,
    as_json: bool,
) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from dut_emulator.recording.recording_files import RECORDING_FORMS, write_recording

    for warning in session.warnings:
        Console(stderr=True, highlight=False).print(translated(warning), style="yellow", markup=False)
    forms = RECORDING_FORMS if form == "both" else (form,)
    errors = Console(stderr=True)
    with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
        task = progress.add_task(session.description.recording_id, total=session.duration_s)
        written = write_recording(
            session,
            out,
            forms,
            stream_format=stream_format,
            truth=truth,
            progress=lambda reached_s: progress.update(task, completed=reached_s),
        )
    if as_json:
        facts = {
            "recording_id": session.description.recording_id,
            "duration_s": session.duration_s,
            "written": [str(path) for path in written],
            "warnings": list(session.warnings),
        }
        typer.echo(json.dumps(facts, ensure_ascii=False))
        return
    named = {"recording": session.description.recording_id, "duration": f"{session.duration_s:g}"}
    typer.echo(say("{recording}: {duration} s recorded", **named))
    for path in written:
        typer.echo(f"  {path}")
