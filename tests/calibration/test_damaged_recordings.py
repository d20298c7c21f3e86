"""Recordings that are damaged or described wrongly: refused with a reason, or told; never a wrong number."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration.evaluations.eleven_point import evaluate_eleven_point
from calibration.evaluations.impact import evaluate_impact
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.evaluations.overload import evaluate_overload
from cli.main import main
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.folder_form import write_folder
from protocol.recordings import Recording

EVALUATE: dict[str, Callable[[tuple[Recording, ...]], MethodEvaluation]] = {
    "impact": evaluate_impact,
    "eleven_point": evaluate_eleven_point,
    "overload": evaluate_overload,
}
LINE = {"axis": 1.0, "cycles": 3.0, "rest_s": 1.0}
Damage = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def sound() -> dict[str, Recording]:
    return {
        "impact": recorded("fog", "impact", values={"shots": 12, "spacing_s": 1.0}, seed=1),
        "eleven_point": recorded(
            "rate_gyro_triad", "eleven_point", values=LINE, seed=1, powered_before_s=600.0
        ),
        "overload": recorded(
            "pulse_imu", "overload", values={"overload_g": 12.0, "cycles": 8.0, "axis": 1.0}, seed=1
        ),
    }


def columns(stream: str, **changed: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Columns by what they were."""

    def damage(recording: Recording) -> Recording:
        old = recording.streams[stream]
        new = {name: changed[name](old.columns[name]) for name in changed}
        stream_now = dataclasses.replace(old, columns={**old.columns, **new})
        return dataclasses.replace(recording, streams={**recording.streams, stream: stream_now})

    return damage


def rows(stream: str, keep: Callable[[int], np.ndarray | slice]) -> Damage:
    def damage(recording: Recording) -> Recording:
        old = recording.streams[stream]
        chosen = keep(len(old))
        kept = {name: values[chosen] for name, values in old.columns.items()}
        stream_now = dataclasses.replace(old, columns=kept)
        return dataclasses.replace(recording, streams={**recording.streams, stream: stream_now})

    return damage


def swapped(*pairs: tuple[str, str]) -> Damage:
    def damage(recording: Recording) -> Recording:
        old = recording.streams["dut"]
        now = dict(old.columns)
        for one, other in pairs:
            now[one], now[other] = old.columns[other], old.columns[one]
        stream_now = dataclasses.replace(old, columns=now)
        return dataclasses.replace(recording, streams={**recording.streams, "dut": stream_now})

    return damage


def believed(sensor: str, **changed: object) -> Damage:
    def damage(recording: Recording) -> Recording:
        new = {**recording.believed, sensor: {**recording.believed[sensor], **changed}}
        return dataclasses.replace(recording, believed=new)

    return damage


def twice(recording: Recording) -> Recording:
    """A second unit's run behind the first, as one recording."""
    streams = {}
    for name, one in recording.streams.items():
        now = {key: np.concatenate([values, values]) for key, values in one.columns.items()}
        now["t"] = np.concatenate([one.columns["t"], one.columns["t"] + 200.0])
        streams[name] = dataclasses.replace(one, columns=now)
    return dataclasses.replace(recording, streams=streams)


def holes(values: np.ndarray, every: int = 7) -> np.ndarray:
    damaged = values.astype(np.float64)
    damaged[::every] = np.nan
    return damaged


def backward(time_s: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(time_s)) > len(time_s) // 2, time_s - 1.0, time_s)


def clipped(values: np.ndarray) -> np.ndarray:
    return np.clip(values, -0.6 * values.max(), 0.6 * values.max())


def spiked(values: np.ndarray) -> np.ndarray:
    damaged = values.copy()
    damaged[len(values) // 2] += 300
    return damaged


REFUSED: list[tuple[str, str, Damage, str]] = [
    ("impact", "time in ms", columns("dut", t=lambda t: t * 1e3), "by their stamps"),
    ("impact", "time backward", columns("dut", t=backward), "do not come after"),
    ("impact", "no stamps", columns("dut", stamp=lambda s: s * np.nan), "No frame is stamped"),
    ("impact", "no output", columns("dut", gyro_z=lambda g: g * np.nan), "not all there"),
    ("impact", "stuck", columns("dut", gyro_z=np.zeros_like), "does not move"),
    (
        "impact",
        "weak",
        columns("dut", gyro_z=lambda g: g + 120_000 * np.sin(np.arange(len(g)))),
        "are needed",
    ),
    ("impact", "counter stuck", columns("dut", counter=np.zeros_like), "frame was lost"),
    ("impact", "empty", rows("dut", lambda n: slice(0, 0)), "nothing in it"),
    ("impact", "ten samples", rows("dut", lambda n: slice(0, 10)), "No frame is stamped"),
    ("eleven_point", "holes", columns("dut", volt_x=lambda v: holes(v, 3)), "is missing"),
    ("eleven_point", "clipped", columns("dut", volt_x=clipped), "saturated"),
    ("eleven_point", "axes swapped", swapped(("volt_x", "volt_y")), "gyro y followed"),
    ("eleven_point", "mV as V", columns("dut", volt_x=lambda v: v * 1e3), "end of the range"),
    ("eleven_point", "deg/s as rad/s", columns("points", rate=np.rad2deg), "table's own rate is another"),
    ("eleven_point", "rad/s as deg/s", columns("points", rate=np.deg2rad), "table's own rate is another"),
    ("eleven_point", "wrong sign of rate", columns("points", rate=np.negative), "own rate is another"),
    ("eleven_point", "unread points", columns("points", axis=holes), "hold missing numbers"),
    ("eleven_point", "overlong", columns("points", duration=lambda d: d + 60.0), "last into the next"),
    ("eleven_point", "points late", columns("dut", t=lambda t: t - 0.5), "not settled"),
    ("eleven_point", "two units", twice, "more than once"),
    ("eleven_point", "time backward", columns("dut", t=backward), "do not come after"),
    ("eleven_point", "ten samples", rows("dut", lambda n: slice(0, 10)), "is missing"),
    ("overload", "time stands", columns("dut", t=np.zeros_like), "do not come after"),
    ("overload", "clocks apart", columns("dut", t=lambda t: t + 0.005), "follows the grating by 5"),
    ("overload", "spike", columns("dut", pulse_gyro_y_pos=spiked), "half-cycles of gyro y"),
    ("overload", "levels", columns("dut", pulse_gyro_x_pos=np.cumsum), "only ever grow"),
    ("overload", "parts of pulses", columns("dut", pulse_gyro_x_pos=lambda p: p * 0.6), "whole numbers"),
    ("overload", "signed pulses", columns("dut", pulse_acc_x_pos=np.negative), "whole numbers"),
    ("overload", "counters swapped", swapped(("pulse_acc_x_pos", "pulse_acc_x_neg")), "mixed up"),
    ("overload", "mm as m", columns("stand", position=lambda x: x * 1e3), "no gravity"),
    ("overload", "g as m/s^2", believed("acc", unit="m/s^2"), "none of an accelerometer"),
    ("overload", "no force", columns("stand", acc_y=lambda a: a * np.nan), "force is missing"),
    ("overload", "force without gravity", columns("stand", acc_y=np.zeros_like), "no gravity"),
    ("overload", "two units", twice, "holes"),
    ("overload", "empty stand", rows("stand", lambda n: slice(0, 0)), "nothing in it"),
    ("overload", "ten samples", rows("dut", lambda n: slice(0, 10)), "cycles"),
]


@pytest.mark.parametrize(
    ("kind", "damage", "words"),
    [(k, d, w) for k, _, d, w in REFUSED],
    ids=[f"{k}: {n}" for k, n, _, _ in REFUSED],
)
def test_what_would_give_a_wrong_number_is_refused(
    sound: dict[str, Recording], kind: str, damage: Damage, words: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as error:
        EVALUATE[kind]((damage(sound[kind]),))
    assert error.value.remedy


def values_of(found: MethodEvaluation) -> dict[str, tuple[float, float]]:
    return {
        one.name: (one.value, one.standard_uncertainty or 0.0)
        for result in found.results
        for one in result.content.quantities
    }


@pytest.mark.parametrize(
    ("kind", "damage", "told"),
    [
        ("impact", columns("dut", gyro_z=lambda g: spiked(g * 1.0)), None),
        ("impact", columns("dut", stamp=lambda s: holes(s, 9001)), "not all there"),
        ("impact", rows("dut", lambda n: np.delete(np.arange(n), np.arange(0, n, 2001))), None),
        ("eleven_point", columns("dut", volt_x=lambda v: holes(v, 40)), "missing values"),
        (
            "eleven_point",
            columns("dut", volt_x=lambda v: v + 5.0 * (np.arange(len(v)) % 97 == 0)),
            "far from",
        ),
        ("eleven_point", columns("dut", volt_x=np.negative), "falls"),
        ("overload", rows("stand", lambda n: np.delete(np.arange(n), np.arange(5, n, 150))), None),
        ("overload", columns("stand", acc_x=lambda a: holes(a, 90)), None),
        ("overload", columns("dut", t=lambda t: t + 4e-4), None),
    ],
)
def test_what_can_be_left_out_is_told_and_changes_nothing(
    sound: dict[str, Recording], kind: str, damage: Damage, told: str | None
) -> None:
    good, found = EVALUATE[kind]((sound[kind],)), EVALUATE[kind]((damage(sound[kind]),))
    said = [*(one.why for one in found.not_used), *found.assumptions]
    assert told is None or any(told in sentence for sentence in said)
    for name, (value, uncertainty) in values_of(found).items():
        true, own = values_of(good)[name]
        assert abs(abs(value) - abs(true)) < 0.5 * max(uncertainty, own), name


def test_the_command_says_what_is_wrong_without_a_traceback(
    sound: dict[str, Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = [twice(sound["eleven_point"]), columns("dut", t=lambda t: t * 1e3)(sound["impact"])]
    for recording in (*damaged, sound["overload"]):
        write_folder(recording, tmp_path / recording.recording_id)
    assert main(["calibrate", str(tmp_path), "--json"]) == 1
    results = json.loads(capsys.readouterr().out)["results"]
    refused = [one["error"]["what"] for one in results if "error" in one]
    assert len(results) == 3
    assert sorted(sentence.split(" ")[0] for sentence in refused) == ["66", "Frames"]
