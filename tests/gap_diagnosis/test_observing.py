"""A recording as the diagnosis sees it, held against hand calculation and the recorder's own belief."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from dut_emulator.recording.recorder import recorded
from gap_diagnosis.decimation import decimated
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observation import Observation
from gap_diagnosis.observing import observe
from protocol.errors import RecordingError
from protocol.recordings import Recording, Stream

DEG, G = math.pi / 180, 9.80665


def stream(name: str, units: dict[str, str], **columns: Any) -> Stream:
    return Stream(name, name, "t", {"t": "s", **units}, {key: np.asarray(v) for key, v in columns.items()})


def made(dut: Stream, stand: Stream | None, believed: dict[str, Any] | None = None, **said: Any) -> Recording:
    streams = {"dut": dut} | ({} if stand is None else {"stand": stand})
    told: dict[str, Any] = {"unit": {"serial": "U-1", "product": "own"}, "test": {"profile": "own"}, **said}
    return Recording("own-1", streams=streams, believed=believed or {}, **told)


def turning(rate_hz: float = 100.0, seconds: float = 20.0, stand_hz: float = 250.0) -> Recording:
    """10 sin(2π 0.5 t) °/s about z, ideal, with a little noise."""
    t, s = np.arange(0, seconds, 1 / rate_hz), np.arange(0, seconds, 1 / stand_hz)
    noise = np.random.default_rng(1).normal(0, 0.01, (3, len(t)))
    wave = 10.0 * np.sin(math.pi * t)
    dut = stream(
        "dut",
        dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), "deg/s"),
        t=t,
        gyro_x=noise[0],
        gyro_y=noise[1],
        gyro_z=wave + noise[2],
    )
    still = np.zeros_like(s)
    stand = stream(
        "stand",
        dict.fromkeys(("rate_x", "rate_y", "rate_z"), "deg/s"),
        t=s,
        rate_x=still,
        rate_y=still,
        rate_z=10.0 * np.sin(math.pi * s),
    )
    return made(dut, stand)


def with_columns(
    recording: Recording, name: str, units: dict[str, str] | None = None, **columns: Any
) -> Recording:
    old = recording.streams[name]
    new = dataclasses.replace(old, columns={**old.columns, **columns}, units={**old.units, **(units or {})})
    return dataclasses.replace(recording, streams={**recording.streams, name: new})


def kept_rows(recording: Recording, name: str, rows: Any) -> Recording:
    old = recording.streams[name]
    new = dataclasses.replace(old, columns={key: values[rows] for key, values in old.columns.items()})
    return dataclasses.replace(recording, streams={**recording.streams, name: new})


def said(observation: Observation) -> str:
    return "; ".join(f"{one.what} {one.count} {one.why}" for one in observation.set_aside)


def test_a_recording_is_seen_in_si_with_its_names() -> None:
    observed = observe(turning())
    gyro = observed.outputs["gyro"]
    assert (observed.recording_id, observed.serial, observed.profile) == ("own-1", "U-1", "own")
    assert np.nanstd(gyro.residual_si, axis=0) == pytest.approx(0.01 * DEG, rel=0.05)
    assert np.ptp(gyro.predicted_si[:, 2]) == pytest.approx(20 * DEG, rel=1e-3)
    assert observed.sample_period_s == pytest.approx(0.01)
    assert (observed.usable[:-2].all(), observed.has_temperature, set(observed.outputs)) == (
        True,
        False,
        {"gyro"},
    )


def test_the_earths_rate_is_told_where_it_is_not_believed() -> None:
    """At 40° N, y north, z up: 0, Ω cos φ, Ω sin φ; turned by the outer gimbal as the axes are."""
    recording = recorded("gnc_module", "static", values={"duration_s": 10.0}, seed=3, serial="U-0007")
    without = dataclasses.replace(recording, believed={**recording.believed, "earth_rate": False})
    level = 7.292115e-5 * np.array([0.0, math.cos(39.96 * DEG), math.sin(39.96 * DEG)])
    for one, in_rate in ((recording, 1.0), (without, 0.0)):
        stimulus = observe(one).stimulus
        assert stimulus.earth_rate_rad_s is not None
        assert stimulus.rate_rad_s is not None
        assert stimulus.earth_rate_rad_s[7] == pytest.approx(level, abs=1e-12)
        assert stimulus.rate_rad_s[7] == pytest.approx(in_rate * level, abs=1e-12)
    heading = dataclasses.replace(recording, site={**recording.site, "heading_deg": 90.0})
    turned = observe(heading).stimulus.earth_rate_rad_s  # y east: north is −x
    assert turned is not None
    assert turned[7] == pytest.approx([-level[1], 0.0, level[2]], abs=1e-12)


def test_a_hole_is_never_bridged() -> None:
    recording = turning()
    stand_s = recording.streams["stand"].columns["t"]
    holed = kept_rows(recording, "stand", (stand_s < 5.0) | (stand_s > 5.1))
    observed = observe(holed)
    inside = (observed.stimulus.time_s > 5.001) & (observed.stimulus.time_s < 5.099)
    assert not observed.usable[inside].any()
    assert np.isnan(observed.outputs["gyro"].predicted_si[inside]).all()
    assert len(set(observed.piece[observed.usable])) == 2
    assert "the stand's report does not cover them" in said(observed)
    few = kept_rows(recording, "stand", np.arange(len(stand_s)) % 50 != 7)  # single rows
    assert observe(few).usable[:-2].all()


def test_a_missing_value_stays_missing_and_is_counted() -> None:
    gyro = turning().streams["dut"].columns["gyro_y"].copy()
    gyro[100:140] = np.nan
    observed = observe(with_columns(turning(), "dut", gyro_y=gyro))
    assert np.isnan(observed.outputs["gyro"].values_si[100:140, 1]).all()
    assert "gyro 40 no values (NaN)" in said(observed)


def test_means_keep_the_residual_and_leave_pieces_alone() -> None:
    gyro = turning().streams["dut"].columns["gyro_z"].copy()
    gyro[203] = np.nan
    recording = with_columns(turning(), "dut", gyro_z=gyro)
    stand_s = recording.streams["stand"].columns["t"]
    observed = observe(kept_rows(recording, "stand", (stand_s < 5.0) | (stand_s > 5.1)))
    few = decimated(observed, 8)
    residual = observed.outputs["gyro"].residual_si
    assert few.outputs["gyro"].residual_si[25, 2] == pytest.approx(
        np.nanmean(residual[200:208, 2]), abs=1e-15
    )
    assert few.stimulus.time_s[25] == pytest.approx(observed.stimulus.time_s[200:208].mean())
    assert (few.stimulus.sample_period_s, few.sample_period_s, few.samples_per_row) == pytest.approx(
        (0.08, 0.01, 8)
    )
    for piece in np.unique(few.piece):
        assert np.diff(few.stimulus.time_s[few.piece == piece]) == pytest.approx(0.08)
    kept = decimated(observe(turning()))
    assert kept.samples_per_row == 7  # (sin x / x)² ≥ 0.995 up to x = 0.122 = π 0.5 Hz 0.078 s
    slow = decimated(observe(recorded("gnc_module", "static", seed=3, serial="U-0007")))
    assert slow.samples_per_row == 20  # 10 Hz


def test_motion_decides_how_many_samples_make_a_row() -> None:
    observed = observe(recorded("mems_ahrs", "rate_staircase", seed=3, serial="U-0007"))
    few = decimated(observed)
    assert few.samples_per_row > 1
    for one, other in ((few, few.outputs[name]) for name in ("gyro", "acc")):
        before = np.diff(
            observed.outputs["gyro" if other is few.outputs["gyro"] else "acc"].predicted_si, axis=0
        )
        after = np.diff(other.predicted_si, axis=0) / one.samples_per_row
        assert (np.sqrt((after**2).mean(axis=0) / (before**2).mean(axis=0)) > 0.994).all()


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        (lambda r: kept_rows(r, "dut", slice(0, 10)), DiagnosisError, "10 samples"),
        (lambda r: dataclasses.replace(r, streams={"dut": r.streams["dut"]}), DiagnosisError, "moved"),
        (lambda r: with_columns(r, "dut", {"gyro_x": "g"}), RecordingError, "gyro_x"),
        (lambda r: dataclasses.replace(r, believed={"gyro": {"matrix": [1, 2]}}), DiagnosisError, "matrix"),
        (lambda r: with_columns(r, "dut", t=np.zeros(2000)), DiagnosisError, "stands still"),
    ],
    ids=["ten-samples", "no-stand", "unit", "belief", "clock-stands"],
)
def test_what_cannot_carry_a_diagnosis_is_refused(change: Any, error: type[Exception], word: str) -> None:
    with pytest.raises(error, match=word) as caught:
        observe(change(turning()))
    assert caught.value.where  # pyright: ignore[reportAttributeAccessIssue]
    assert caught.value.remedy  # pyright: ignore[reportAttributeAccessIssue]
