"""Pictures of a unit: Allan deviations at rest, errors over temperature, answer to a step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from calibration.algorithms.allan_variance import overlapping_allan_deviation
from cli.picture_style import picture_style
from dut_emulator.effects.effect import FloatArray, SensorName
from dut_emulator.picture_style import COLOURS, GRID
from dut_emulator.products.product import Product
from dut_emulator.recording import unit_character
from dut_emulator.recording.recording_files import refuse_existing
from dut_emulator.twin import Twin
from protocol.durable_files import storage_error
from protocol.language import say
from protocol.units_of_measure import factor_to_si

REST_S = 3 * 3600.0
MAX_REST_SAMPLES = 1_000_000
AXES = "xyz"
SETTLED = 0.01
SHORTEST_SPAN_S = 2e-4
_UNITS: dict[SensorName, tuple[str, str]] = {
    "gyro": ("deg/h", "deg/s"),
    "acc": ("ug", "mg"),
    "mag": ("uT", "uT"),
}
"""Of Allan deviations, and of errors over temperature unless they are small."""
_SMALL = 0.01
_SIZE_PER_TRIAD_IN = (5.2, 3.6)
_DOTS_PER_INCH = 110


@dataclass(frozen=True)
class DrawnUnit:
    """What is drawn. `axes`: those that each triad has; `rate_hz`: at which it samples at rest."""

    name: str
    twin: Twin
    axes: Mapping[SensorName, Sequence[int]]
    rate_hz: float


def unit_to_draw(twin: Twin, name: str, product: Product) -> DrawnUnit:
    """A product's unit: a row of zeros in the believed matrix is a sensor that is not there."""
    believed = product.believed(twin)
    axes: dict[SensorName, Sequence[int]] = {}
    for sensor in unit_character.triads(twin):
        matrix = np.asarray(believed.get(sensor, {}).get("matrix", np.eye(3)))
        axes[sensor] = [axis for axis in range(3) if matrix[axis].any()]
    slowest_hz = min(mounting.rate_hz for mounting in product.profiles.values())
    at_rest = product.profiles.get("static")
    return DrawnUnit(name, twin, axes, at_rest.rate_hz if at_rest else slowest_hz)


def write_plots(unit: DrawnUnit, directory: Path) -> list[Path]:
    """Three pictures as PNG in `directory`, made if it is not there; what was written.

    Raises:
        RecordingError: there is something of such a name, or the disk refuses.
    """
    pictures = {
        directory / f"{unit.name}-{word}.png": draw
        for word, draw in (("allan", _allan), ("temperature", _temperature), ("step", _step))
    }
    for path in pictures:
        refuse_existing(path)
    with mpl.rc_context(picture_style()):
        for path, draw in pictures.items():
            try:
                directory.mkdir(parents=True, exist_ok=True)
                FigureCanvasAgg(draw(unit)).print_png(path)
            except OSError as error:
                raise storage_error(error, path, "file") from error
    return list(pictures)


def _allan(unit: DrawnUnit) -> Figure:
    figure, panels = _figure(say("{unit}: Allan deviation at rest", unit=unit.name), unit)
    samples = int(min(REST_S * unit.rate_hz, MAX_REST_SAMPLES))
    for (sensor, axes), (panel,) in zip(unit.axes.items(), panels, strict=True):
        measure = _UNITS[sensor][0]
        output = unit_character.at_rest(unit.twin, sensor, unit.rate_hz, samples) / factor_to_si(measure)
        for axis in axes:
            allan = overlapping_allan_deviation(output[:, axis], unit.rate_hz)
            panel.loglog(allan.tau_s, allan.deviation, color=COLOURS[axis], label=AXES[axis])
        beside = say("Allan deviation, {unit}", unit=measure)
        _finish(panel, sensor, say("averaging time, s"), beside)
    return figure


def _temperature(unit: DrawnUnit) -> Figure:
    figure, panels = _figure(say("{unit}: errors over temperature", unit=unit.name), unit, rows=2)
    for (sensor, axes), (top, bottom) in zip(unit.axes.items(), panels, strict=True):
        curve = unit_character.over_temperature(unit.twin, sensor)
        largest = np.abs(curve.error[:, axes]).max(initial=0.0)
        measure = _UNITS[sensor][1 if largest >= _SMALL * factor_to_si(_UNITS[sensor][1]) else 0]
        for axis in axes:
            drawn = {"color": COLOURS[axis], "label": AXES[axis]}
            top.plot(curve.temperature_c, curve.error[:, axis] / factor_to_si(measure), **drawn)
            ppm = curve.scale_factor_error[:, axis] / factor_to_si("ppm")
            bottom.plot(curve.temperature_c, ppm, **drawn)
        _finish(top, sensor, "", say("error at rest, {unit}", unit=measure))
        below = say("temperature, °C: room, hot, cold, room at 1 °C a minute")
        _finish(bottom, sensor, below, say("scale factor error, ppm"))
    return figure


def _step(unit: DrawnUnit) -> Figure:
    figure, panels = _figure(say("{unit}: answer to a step, without noise", unit=unit.name), unit)
    for (sensor, axes), (panel,) in zip(unit.axes.items(), panels, strict=True):
        times_s, answer = _until_the_step(*unit_character.step_response(unit.twin, sensor))
        for axis in axes:
            panel.plot(times_s * 1e3, answer[:, axis], color=COLOURS[axis], label=AXES[axis])
        panel.axhline(1.0, color="0.6", linewidth=0.8, zorder=0)
        panel.axvline(0.0, color="0.6", linewidth=0.8, zorder=0)
        panel.set_xlim(*_span_ms(times_s, answer[:, axes]))
        _finish(panel, sensor, say("time from the step, ms"), say("answer over input"))
    return figure


def _until_the_step(times_s: FloatArray, answer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """With one point more: just before the step nothing has answered, whatever a line would make of it."""
    at = int(np.searchsorted(times_s, 0.0))
    return np.insert(times_s, at, 0.0), np.insert(answer, at, answer[at - 1], axis=0)


def _figure(title: str, unit: DrawnUnit, rows: int = 1) -> tuple[Figure, list[list[Any]]]:
    """A column of panels for each triad."""
    width, height = _SIZE_PER_TRIAD_IN
    count = max(len(unit.axes), 1)
    figure = Figure(figsize=(width * count, height * rows), dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(rows, count, squeeze=False)
    return figure, [[panels[row][column] for row in range(rows)] for column in range(len(unit.axes))]


def _finish(panel: Any, sensor: SensorName, below: str, beside: str) -> None:
    panel.set_title(say({"gyro": "Gyro", "acc": "Accelerometer", "mag": "Magnetometer"}[sensor]))
    panel.set_xlabel(below)
    panel.set_ylabel(beside)
    panel.grid(**GRID)
    if panel.lines:
        panel.legend(title="", frameon=False)


def _span_ms(times_s: FloatArray, answer: FloatArray) -> tuple[float, float]:
    """From a little before the step until twice the time in which the answer has settled."""
    late = np.abs(answer - answer[-1]).max(axis=1, initial=0.0) > SETTLED
    settled_s = float(times_s[late][-1]) if late.any() else 0.0
    settled_s = max(settled_s, SHORTEST_SPAN_S)
    return -500 * settled_s, 2000 * settled_s
