"""Profile 'warm_up': the thermal network of a unit that is switched on in steady air (paper 2, 2.1).

The stream 'thermocouples' has a column temp_<node> for each node that carries a sensor, the stand's stream
the temperature of the air. What each node dissipates and which nodes touch is the designer's knowledge, in
believed.thermal: {"heat_w": {node: W}, "edges": [[node, node or "ambient"], ...]}; temperatures alone tell
only ratios.
"""

# pyright: strict
import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.thermal_network import (
    MEASURED_SCHEMES,
    SIMULATED_SCHEMES,
    ThermalNetwork,
    WarmUp,
    fit_thermal_network,
    which_scheme,
)
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.records.thermal_network_contents import thermal_network_content
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

STREAM = "thermocouples"
PREFIX = "temp_"
MAX_AMBIENT_DRIFT_C = 1.0
MOST_ROWS = 600
"""Of the fit; a longer recording is averaged over equal stretches."""
MIN_SHOWN_K = 1e-4


def evaluate_warm_up(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Capacities, conductances, steady rises, settling time, and the cooling scheme that they show.

    Raises:
        CalibrationError: no node temperatures, no powers or edges, air that did not stay, or a network that
            the temperatures do not tell (the parameter is named).
    """
    (recording,) = recordings
    power, edges = _design(recording)
    nodes = tuple(power)
    warm_up = _warm_up(recording, nodes, np.array(list(power.values())))
    try:
        network = fit_thermal_network([warm_up], nodes, edges)
    except CalibrationError as error:
        raise refused(recording, error.what, error.remedy.removesuffix("."), f"stream {STREAM}") from None
    rise = warm_up.temperature_c - warm_up.ambient_c
    first = np.where(np.isfinite(rise[0]), rise[0], 0.0)
    content = thermal_network_content(network, warm_up.power_w, warm_up.time_s, rise, first)
    sentences = [
        say(
            "{watts} W in all as the design says, constant; air at {ambient} °C; radiation as a conductance",
            watts=f"{float(warm_up.power_w.sum()):.3g}",
            ambient=f"{warm_up.ambient_c:.1f}",
        ),
        say("residual {rms} °C rms", rms=f"{network.residual_rms_k:.2g}"),
        *_schemes(network, warm_up.power_w),
    ]
    beside = (Beside(say("residual of the temperatures, rms"), network.residual_rms_k, "degC"),)
    return method_evaluation(recordings, [SensorResult("thermal", content, recordings, beside)], sentences)


def _schemes(network: ThermalNetwork, power_w: FloatArray) -> list[str]:
    """Which of paper 2's cooling schemes the hottest node's rise belongs to, by either of its sets."""
    rise, u = network.steady_rise_k(power_w)
    hottest = int(rise.argmax())
    places = max(0, 1 - math.floor(math.log10(max(float(u[hottest]), MIN_SHOWN_K))))
    sentences: list[str] = []
    for source, schemes in ((say("measured"), MEASURED_SCHEMES), (say("simulated"), SIMULATED_SCHEMES)):
        verdict = which_scheme(float(rise[hottest]), float(u[hottest]), schemes)
        clear = say("clearly") if verdict.clear else say("not clearly")
        sentences.append(
            say(
                "hottest node {rise} ± {u} °C above the air: beside the figures of Liu, Hang, Li & Sun "
                "({source}) {clear} '{scheme}' ({paper} °C), at their power",
                rise=f"{rise[hottest]:.{places}f}",
                u=f"{u[hottest]:.{places}f}",
                source=source,
                clear=clear,
                scheme=say(verdict.scheme.name),
                paper=f"{verdict.scheme.steady_rise_k:g}",
            )
        )
    return sentences


def _design(recording: Recording) -> tuple[dict[str, float], tuple[tuple[str, str], ...]]:
    """Heat of each node in W, and the edges."""
    stated = recording.believed.get("thermal")
    thermal: Mapping[str, Any] = cast(Mapping[str, Any], stated) if isinstance(stated, Mapping) else {}
    try:
        power = {str(node): float(watts) for node, watts in thermal["heat_w"].items()}
        edges = tuple((str(one), str(other)) for one, other in thermal["edges"])
    except (KeyError, TypeError, ValueError, AttributeError):
        power, edges = {}, ()
    if not power or not edges or not all(np.isfinite(watts) and watts >= 0 for watts in power.values()):
        raise refused(
            recording,
            "The recording does not say what each node dissipates and which nodes touch.",
            'write believed.thermal: {"heat_w": {node: W, …}, "edges": [[node, node or "ambient"], …]}',
        )
    return power, edges


def _warm_up(recording: Recording, nodes: tuple[str, ...], power_w: FloatArray) -> WarmUp:
    stream = stream_with(recording, STREAM)
    names = [f"{PREFIX}{node}" for node in nodes]
    if not any(name in stream.columns for name in names):
        raise refused(
            recording,
            "No node of the network has a temperature.",
            f"record {', '.join(names)} in the stream '{STREAM}'",
            f"stream {STREAM}",
        )
    air = np.asarray(stream_with(recording, "stand", "temp").columns["temp"], dtype=np.float64)
    if not float(np.nanmax(air) - np.nanmin(air)) <= MAX_AMBIENT_DRIFT_C:
        raise refused(
            recording,
            f"The air changed by {np.nanmax(air) - np.nanmin(air):.1f} °C while the unit warmed up.",
            "let the chamber soak before the unit is switched on",
            "stream stand, temp",
        )
    power_on = recording.test.get("power_on_s", 0.0)
    time_s = stream.time_s() - (float(power_on) if isinstance(power_on, int | float) else 0.0)
    nothing = np.full(len(stream), np.nan)
    temperature = np.stack(
        [np.asarray(stream.columns.get(name, nothing), dtype=np.float64) for name in names], axis=1
    )
    keep = time_s >= 0
    together = max(1, -(-int(keep.sum()) // MOST_ROWS))
    whole = int(keep.sum()) // together * together
    time_s = time_s[keep][:whole].reshape(-1, together).mean(axis=1)
    temperature = temperature[keep][:whole].reshape(-1, together, len(nodes)).mean(axis=1)
    return WarmUp(time_s, temperature, power_w, float(np.nanmean(air)))
