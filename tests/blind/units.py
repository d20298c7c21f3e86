"""A unit as it is believed and as it is: matrices, biases, noise levels; and the folders it leaves behind.

The folder form is written with numpy and json alone, after the words of the contract.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.effect_shapes import STANDARD_GRAVITY, TRIADS
from tests.blind.excitations import FIELD_LAB, LATITUDE_DEG, Excitation, Run
from tests.blind.metric import stimulus
from tests.blind.noise import ChannelNoise

Array = NDArray[np.float64]

PROFILES = {
    "staircase": "rate_staircase_temperature",
    "tumble": "tumble",
    "static_ramp": "static_temperature",
    "swing": "swing_and_sweep",
}


@dataclass
class Unit:
    """Believed document and true parameters of one unit in one case.

    Attributes:
        serial: of the unit.
        believed: as it stands in recording.json.
        noise: channel to its true noise.
        believed_noise: channel to the noise that is believed.
        spreads: triad to (white, slow) relative spreads.
        matrices: (mount, triad) to the true matrix, mounting included.
        biases: (run, channel) to the true bias.
        quanta: channel to its quantum, 0 for none.
    """

    serial: str
    believed: dict[str, Any]
    noise: dict[str, ChannelNoise]
    believed_noise: dict[str, ChannelNoise]
    spreads: dict[str, tuple[float, float]]
    matrices: dict[tuple[int, str], Array] = field(default_factory=dict)
    biases: dict[tuple[int, str], float] = field(default_factory=dict)
    quanta: dict[str, float] = field(default_factory=dict)

    def scale_gyro_noise(self, factor: float) -> None:
        """Make a worse gyro of it: all its noise, believed and true, and its quantum."""
        words = self.believed["gyro"]
        for word in ("angle_random_walk", "bias_instability"):
            words[word]["value"] *= factor
        if "quantum" in words:
            words["quantum"] *= factor
        for channel in TRIADS["gyro"]:
            self.noise[channel] = self.noise[channel].scaled(factor)
            self.believed_noise[channel] = self.believed_noise[channel].scaled(factor)
            self.quanta[channel] *= factor


_FIGURES = {
    # white noise: word, unit, (low, high), factor to channel units per sqrt(Hz); then the slow noise
    "gyro": ("angle_random_walk", "deg/sqrt(h)", (0.1, 0.6), 1 / 60, "deg/h", (2, 20), 1 / 3600),
    "acc": (
        "velocity_random_walk",
        "m/s/sqrt(h)",
        (0.03, 0.15),
        1 / 60 / STANDARD_GRAVITY,
        "ug",
        (10, 60),
        1e-6,
    ),
    "mag": ("white_noise", "uT/sqrt(Hz)", (0.02, 0.1), 1.0, "uT", None, 0.0),
}
_CHANNEL_UNITS = {"gyro": "deg/s", "acc": "g", "mag": "uT"}
_BIAS = {"gyro": (0.3, 0.02), "acc": (0.01, 0.001), "mag": (3.0, 0.3)}
"""Standard deviations of what is believed of the bias, and of the change from run to run."""


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def drawn_unit(rng: np.random.Generator, excitation: Excitation) -> Unit:
    """A unit for an excitation: what is believed of it, and what it is.

    Args:
        rng: source of all draws.
        excitation: which channels there are, runs and mounts.
    """
    rate = excitation.runs[0].rate_hz
    unit = Unit(f"B-{int(rng.integers(10**6)):06d}", {}, {}, {}, {})
    turns = {mount: rng.normal(0, 1e-3, 3) for mount in sorted({run.mount for run in excitation.runs})}
    few_terms = rng.random() < 0.25
    for triad in ("gyro", "acc", "mag") if excitation.magnetometer else ("gyro", "acc"):
        word, white_unit, white_range, factor, slow_unit, slow_range, slow_factor = _FIGURES[triad]
        figure = _log_uniform(rng, *white_range)
        spread = float(rng.uniform(0.2, 0.4))
        matrix = np.eye(3) + rng.normal(0, 2e-3, (3, 3))
        bias = rng.normal(0, _BIAS[triad][0], 3)
        words: dict[str, Any] = {
            "matrix": matrix.tolist(), "bias": bias.tolist(), "unit": _CHANNEL_UNITS[triad],
            word: {"value": figure, "unit": white_unit, "unit_spread": spread},
        }  # fmt: skip
        white = figure * factor * np.sqrt(rate)
        terms: list[tuple[float, float]] = []
        slow_spread = float(rng.uniform(0.3, 0.5))
        if slow_range is not None:
            slow, tau = _log_uniform(rng, *slow_range), _log_uniform(rng, 100, 500)
            words["bias_instability"] = {
                "value": slow, "unit": slow_unit, "unit_spread": slow_spread, "correlation_time_s": tau
            }  # fmt: skip
            taus = (tau / 2.2, tau, tau * 2.2) if few_terms else (tau,)
            terms = [(slow * slow_factor / np.sqrt(len(taus)), one) for one in taus]
        quantum = float(white * rng.uniform(0.05, 0.3)) if rng.random() < 0.3 else 0.0
        if quantum:
            words["quantum"] = quantum
        unit.believed[triad] = words
        unit.spreads[triad] = (spread, slow_spread)
        _draw_truth(rng, unit, triad, excitation, ChannelNoise(rate, white, tuple(terms)), quantum, turns)
    return unit


def _draw_truth(
    rng: np.random.Generator,
    unit: Unit,
    triad: str,
    excitation: Excitation,
    noise: ChannelNoise,
    quantum: float,
    turns: dict[int, Array],
) -> None:
    """True levels (log-normal about what is believed, mostly common to the axes), matrices and biases."""
    words = unit.believed[triad]
    common = rng.normal(0, np.sqrt(0.8), 2)
    for axis, channel in enumerate(TRIADS[triad]):
        log_levels = np.array(unit.spreads[triad]) * (common + rng.normal(0, np.sqrt(0.2), 2))
        white, slow = np.exp(log_levels)
        terms = tuple((sigma * slow, tau) for sigma, tau in noise.terms)
        unit.believed_noise[channel] = noise
        unit.noise[channel] = replace(noise, white=noise.white * white, terms=terms)
        unit.quanta[channel] = quantum
        for number in range(len(excitation.runs)):
            unit.biases[number, channel] = float(words["bias"][axis] + rng.normal(0, _BIAS[triad][1]))
    off = rng.normal(0, 1e-3, (3, 3)) * (1 - np.eye(3)) + np.diag(rng.normal(0, 5e-4, 3))
    for mount in turns:
        x, y, z = turns[mount]
        mounted = np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        unit.matrices[mount, triad] = np.array(words["matrix"]) @ (np.eye(3) + off) @ mounted


@dataclass
class Frames:
    """One run as the unit sent it and as the stand reported it: columns at the output rate."""

    dut: dict[str, Array]
    stand: dict[str, Array]


def recorded(
    rng: np.random.Generator,
    unit: Unit,
    excitation: Excitation,
    signal: dict[str, Array],
    noise: dict[str, Array],
) -> list[Frames]:
    """What a unit with a hidden signal and this noise leaves behind; channel to (all rows,) both."""
    frames = []
    for number, (run, part) in enumerate(zip(excitation.runs, excitation.slices(), strict=True)):
        truth = {triad: run.averaged(stimulus(run, triad)) for triad in ("gyro", "acc", "mag")}
        dut: dict[str, Array] = {"t": run.averaged(run.t)}
        for channel in unit.noise:
            triad = channel.split("_")[0]
            row = unit.matrices[run.mount, triad][TRIADS[triad].index(channel)]
            y = truth[triad] @ row + unit.biases[number, channel] + noise[channel][part]
            y = y + signal[channel][part] if channel in signal else y
            quantum = unit.quanta[channel]
            dut[channel] = np.round(y / quantum) * quantum if quantum else y
        dut["temp"] = run.averaged(run.temperature) + rng.normal(0, 0.005, run.rows)
        if excitation.supply:
            dut["supply"] = run.averaged(run.supply) + rng.normal(0, 0.001, run.rows)
        dut["counter"] = np.arange(run.rows, dtype=float)
        frames.append(Frames(dut, _stand(rng, run, truth, excitation.magnetometer)))
    return frames


def _stand(
    rng: np.random.Generator, run: Run, truth: dict[str, Array], magnetometer: bool
) -> dict[str, Array]:
    columns: dict[str, Array] = {"t": run.averaged(run.t)}
    for axis, name in enumerate("xyz"):
        columns[f"rate_{name}"] = truth["gyro"][:, axis] + rng.normal(0, 2e-4, run.rows)
    for axis, name in enumerate("xyz"):
        columns[f"acc_{name}"] = truth["acc"][:, axis] + rng.normal(0, 2e-6, run.rows)
    if magnetometer:
        for axis, name in enumerate("xyz"):
            columns[f"mag_{name}"] = truth["mag"][:, axis]
    columns["temp"] = run.averaged(run.chamber)
    angles = np.rad2deg(run.averaged(run.angles)) % 360
    for axis, name in enumerate(("outer", "middle", "inner")):
        columns[f"angle_{name}"] = angles[:, axis]
    return columns


_COLUMN_UNITS = {
    **{"t": "s", "temp": "degC", "supply": "V", "counter": "1"},
    **{"gyro": "deg/s", "acc": "g", "mag": "uT", "rate": "deg/s", "angle": "deg"},
}


def _stream(folder: Path, name: str, columns: dict[str, Array]) -> dict[str, Any]:
    types = {"t": np.float64, "counter": np.uint32}
    np.savez(folder / f"{name}.npz", **{c: x.astype(types.get(c, np.float32)) for c, x in columns.items()})
    units = {column: _COLUMN_UNITS[column.split("_")[0]] for column in columns}
    return {"name": name, "file": f"{name}.npz", "clock": name, "time": "t", "columns": units}


def write_case(folder: Path, unit: Unit, excitation: Excitation, frames: list[Frames]) -> None:
    """Each run as a folder in the form of the contract."""
    for number, (run, one) in enumerate(zip(excitation.runs, frames, strict=True), 1):
        name = f"{folder.name}-run-{number}"
        (folder / name).mkdir(parents=True)
        document = {
            "format": "testloom-recording/1",
            "recording_id": name,
            "unit": {"serial": unit.serial, "product": "mems_ahrs"},
            "test": {"profile": PROFILES[excitation.kind], "run": number, "mount": f"m{run.mount}"},
            "stand": {"id": "blind-1", "kind": "three_axis_turntable"},
            "site": {"latitude_deg": LATITUDE_DEG, "gravity_m_s2": STANDARD_GRAVITY,
                     "field_uT": [FIELD_LAB[0], -FIELD_LAB[1], -FIELD_LAB[2]]},
            "streams": [_stream(folder / name, "dut", one.dut), _stream(folder / name, "stand", one.stand)],
            "believed": unit.believed,
        }  # fmt: skip
        (folder / name / "recording.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
