"""What people and scripts see of an evaluation by a profile's method."""

from typing import Any

from rich.console import Console
from rich.table import Table

from calibration.evaluations.method_evaluation import MethodEvaluation, SensorResult
from calibration.records.derived_units import written_unit
from calibration.records.record_parts import CalibratedQuantity
from cli.uncertain_numbers import gum, plain
from protocol.language import say, translated

PROFILE_WORDS = {
    "impact": "pure lag from the stamps of impacts (paper 3)",
    "eleven_point": "rates up and down on a table: line, linearity, hysteresis, repeatability (paper 4)",
    "overload": "sinusoidal overload: asymmetry, odd quadratic term, g-sensitivity (paper 5)",
    "static": "at rest: noise coefficients of IEEE 952, bias, bias stability, repeatability",
    "rate_staircase": "staircase of rates: scale factor, linearity, asymmetry, geometry, repeatability",
    "sweep": "sine sweep: gain, delay, lag, bandwidth",
    "tumble": "tumble in gravity: g-sensitivity, quadratic term of the accelerometers",
    "thermal_positions": "soaks on a thermal turntable over the matrix of room temperature (paper 2)",
    "warm_up": "warm-up in steady air: thermal network, cooling scheme (paper 2)",
    "temperature_ramp": "ramps of temperature both ways: bias, hysteresis, what follows dT/dt (IEEE 952)",
    "spin": "spin in a steady field: zeros, sensitivity ratio, orthogonality (paper 1)",
    "hand_tumble": "turned all ways in one field: hard and soft iron (ellipsoid)",
    "swing": "swing against a turntable: lag, clock drift, attitude error without them (paper 2)",
    "flight": "flight against a reference: roll and pitch errors by phase, 1 sigma (paper 2)",
    "vehicle_run": "drive against a reference: roll and pitch errors by phase, 1 sigma (paper 2)",
}


def show_method_evaluation(console: Console, evaluation: MethodEvaluation) -> None:
    """Assumptions, and a table for each sensor."""
    console.print(
        say("Unit {serial} ({product})", serial=evaluation.serial, product=evaluation.product), style="bold"
    )
    console.print(say("Method: {method}", method=say(PROFILE_WORDS[evaluation.profile])))
    for sentence in evaluation.assumptions:
        console.print(f"  · {translated(sentence)}")
    for result in evaluation.results:
        console.print(_table(result, len(evaluation.results)))


def _table(result: SensorResult, results: int) -> Table:
    names = ", ".join(recording.recording_id for recording in result.recordings)
    title = result.sensor if results == 1 else f"{result.sensor} ({names})"
    table = Table(
        header_style="bold",
        title=title,
        caption=say("value ± standard uncertainty; below it: for comparison"),
    )
    for heading in ("Quantity", "Symbol", "Value", "Unit"):
        table.add_column(say(heading), overflow="fold")
    for one in result.content.quantities:
        table.add_row(one.name, one.symbol, _value(one), written_unit(one.unit))
    if result.beside:
        table.add_section()
    for figure in result.beside:
        value = say("not defined here") if figure.value is None else plain(figure.value, 5)
        table.add_row(translated(figure.name), "", value, written_unit(figure.unit))
    return table


def _value(one: CalibratedQuantity) -> str:
    bounds = (
        "" if one.interval is None else f" [{plain(one.interval.lower, 4)} … {plain(one.interval.upper, 4)}]"
    )
    if one.standard_uncertainty is None:
        return plain(one.value, 3) + ", " + say("not determined") + bounds
    return gum(one.value, one.standard_uncertainty) + bounds


def method_evaluation_json(evaluation: MethodEvaluation) -> dict[str, Any]:
    """The same for scripts."""
    return {
        "recordings": list(evaluation.recording_ids),
        "unit": {"serial": evaluation.serial, "product": evaluation.product},
        "profile": evaluation.profile,
        "method": evaluation.results[0].content.method,
        "results": [_result_json(result) for result in evaluation.results],
        "assumptions": list(evaluation.assumptions),
        "not_used": [
            {"what": item.what, "count": item.count, "why": item.why} for item in evaluation.not_used
        ],
    }


def _result_json(result: SensorResult) -> dict[str, Any]:
    content = result.content
    return {
        "sensor": result.sensor,
        "recordings": [recording.recording_id for recording in result.recordings],
        "quantities": [one.model_dump(mode="json") for one in content.quantities],
        "covariance": [block.model_dump(mode="json") for block in content.covariance],
        "beside": [
            {"name": figure.name, "value": figure.value, "unit": figure.unit} for figure in result.beside
        ],
    }
