"""Recordings that something is wrong with: refused in words, or used with what was set aside said."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dut_emulator.recording.recorder import recorded
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observation import Observation
from gap_diagnosis.observing import observe
from gap_diagnosis.together import check_together
from protocol.errors import Fault
from protocol.recordings import Recording, Stream

DEG, G = math.pi / 180, 9.80665
GYRO, ACC = ("gyro_x", "gyro_y", "gyro_z"), ("acc_x", "acc_y", "acc_z")
RATE = ("rate_x", "rate_y", "rate_z")
Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def swung() -> Recording:
    """An attitude unit, swung about x for 49 s."""
    return recorded("mems_ahrs", "swing", seed=3, serial="U-0007")


@pytest.fixture(scope="module")
def turned_about_all() -> Recording:
    return recorded("mems_ahrs", "rate_staircase", values={"dwell_s": 1.0}, seed=3, serial="U-0007")


def changed(
    recording: Recording, stream: str, units: dict[str, str] | None = None, **columns: Any
) -> Recording:
    old = recording.streams[stream]
    new = dataclasses.replace(old, columns={**old.columns, **columns}, units={**old.units, **(units or {})})
    return dataclasses.replace(recording, streams={**recording.streams, stream: new})


def rows(recording: Recording, stream: str, kept: Any) -> Recording:
    old = recording.streams[stream]
    new = dataclasses.replace(old, columns={name: values[kept] for name, values in old.columns.items()})
    return dataclasses.replace(recording, streams={**recording.streams, stream: new})


def dut(recording: Recording) -> dict[str, Any]:
    return {name: values.copy() for name, values in recording.streams["dut"].columns.items()}


def said(observed: Observation) -> str:
    return "; ".join(f"{one.what} {one.count} {one.why}" for one in observed.set_aside)


def turned(name: str) -> Change:
    return lambda recording: changed(recording, "dut", **{name: -dut(recording)[name]})


def exchanged(one: str, other: str) -> Change:
    return lambda recording: changed(
        recording, "dut", **{one: dut(recording)[other], other: dut(recording)[one]}
    )


def relabelled(names: tuple[str, ...], unit: str) -> Change:
    return lambda recording: changed(recording, "dut", dict.fromkeys(names, unit))


@pytest.mark.parametrize(
    ("mistake", "word"),
    [
        (turned("gyro_y"), "gyro_y has the wrong sign"),
        (turned("acc_x"), "acc_x has the wrong sign"),
        (exchanged("gyro_x", "gyro_z"), "gyro_x shows what the stand reports for z"),
        (relabelled(GYRO, "rad/s"), "a column in 'deg/s' was taken for one in 'rad/s'"),
        (relabelled(ACC, "m/s^2"), "a column in 'g' was taken for one in 'm/s\\^2'"),
        (relabelled(GYRO, "deg/h"), "a column in 'deg/s' was taken for one in 'deg/h'"),
    ],
    ids=["gyro-sign", "acc-sign", "axes", "deg/s-as-rad/s", "g-as-m/s2", "deg/s-as-deg/h"],
)
def test_mistakes_of_a_bench_are_known_for_what_they_are(
    turned_about_all: Recording, mistake: Change, word: str
) -> None:
    with pytest.raises(DiagnosisError, match=word) as caught:
        observe(mistake(turned_about_all))
    assert caught.value.fault == Fault.DATA
    assert "columns" in caught.value.where
    assert "column" in caught.value.remedy


def test_an_honest_recording_is_no_mistake(swung: Recording) -> None:
    observed = observe(swung)
    assert set(observed.outputs) == {"gyro", "acc", "temperature"}
    assert observed.set_aside == ()


def test_g_taken_for_m_s2_is_known_at_rest_too() -> None:
    """All-zero excitation is allowed; gravity alone tells the accelerometer's unit."""
    still = recorded("mems_ahrs", "static", values={"duration_s": 20.0}, seed=3, serial="U-0007")
    observed = observe(still)
    assert [one.effect for one in observed.timing if one.log_likelihood_ratio > 12] == []
    assert "the unit was at rest" in said(observed)
    with pytest.raises(DiagnosisError, match="a column in 'g' was taken for one in 'm/s\\^2'"):
        observe(relabelled(ACC, "m/s^2")(still))


def test_recordings_of_two_units_are_no_diagnosis(swung: Recording) -> None:
    again = dataclasses.replace(swung, recording_id="other", test={**swung.test, "run": 2})
    check_together([swung, again])
    foreign = dataclasses.replace(again, unit={**swung.unit, "serial": "U-0008"})
    doubted = dataclasses.replace(again, believed={})
    for wrong, word in (
        ([swung, foreign], "several units: U-0007 .*U-0008"),
        ([swung, swung, dataclasses.replace(swung)], "Two recordings are named"),
        ([swung, doubted], "believed one thing"),
        ([], "no recording"),
    ):
        with pytest.raises(DiagnosisError, match=word) as caught:
            check_together(wrong)
        assert caught.value.remedy


def test_no_common_time_is_refused(swung: Recording) -> None:
    """A stand at rest, an hour later: nothing tells where the one lies in the other."""
    stand = swung.streams["stand"].columns
    later = changed(swung, "stand", t=stand["t"] + 3600.0, **dict.fromkeys(RATE, np.zeros(len(stand["t"]))))
    for name in ACC:
        later = changed(later, "stand", **{name: np.full(len(stand["t"]), stand[name][0])})
    with pytest.raises(DiagnosisError, match="no time in common"):
        observe(later)


def test_motion_that_no_stand_reports_is_refused_and_rest_is_not(swung: Recording) -> None:
    alone = dataclasses.replace(swung, streams={"dut": swung.streams["dut"]})
    with pytest.raises(DiagnosisError, match="moved"):
        observe(alone)
    still = recorded("gnc_module", "static", values={"duration_s": 20.0}, seed=3, serial="U-0007")
    observed = observe(dataclasses.replace(still, streams={"dut": still.streams["dut"]}))
    assert set(observed.outputs) == {"gyro"}  # where up is nobody knows
    assert observed.stimulus.specific_force_m_s2 is None
    assert "acc 4001 the stand tells nothing that predicts it" in said(observed)


def test_a_long_stretch_without_samples_begins_a_new_piece(swung: Recording) -> None:
    t = dut(swung)["t"]
    observed = observe(rows(swung, "dut", (t < 10.0) | (t > 20.0)))
    assert len(observed) == int(((t < 10.0) | (t > 20.0)).sum())
    assert len(np.unique(observed.piece)) == 2
    assert "frames" in said(observed)


def test_saturated_and_frozen_stretches_are_set_aside(swung: Recording) -> None:
    columns = dut(swung)
    at_end = columns["gyro_x"] > 50.0
    columns["gyro_x"][at_end] = 400.0
    for name in ACC:
        columns[name][2000:2400] = columns[name][2000]
    observed = observe(changed(swung, "dut", **{name: columns[name] for name in ("gyro_x", *ACC)}))
    assert np.isnan(observed.outputs["gyro"].values_si[at_end, 0]).all()
    assert np.isfinite(observed.outputs["gyro"].values_si[~at_end, 0]).all()
    assert np.isnan(observed.outputs["acc"].values_si[2001:2400]).all()
    assert np.isfinite(observed.outputs["acc"].values_si[:2001]).all()
    assert f"gyro_x {int(at_end.sum())} saturated" in said(observed)
    assert "acc 399 frozen" in said(observed)


def test_a_channel_that_stops_below_its_range_is_a_finding(swung: Recording) -> None:
    """The stand goes on: the stop has a name, and its rows tell nothing else."""
    clipped = np.clip(dut(swung)["gyro_x"], -50.0, 50.0)
    observed = observe(changed(swung, "dut", gyro_x=clipped))
    (finding,) = [one for one in observed.timing if one.effect == "gyro.saturation"]
    assert finding.value == pytest.approx(50.0 * DEG, abs=4 * finding.standard_uncertainty)
    stopped = np.abs(dut(swung)["gyro_x"]) >= 50.0
    assert (np.isnan(observed.outputs["gyro"].values_si[:, 0]) == stopped).all()


def test_three_tenths_of_the_frames_lost_leave_the_rest(swung: Recording) -> None:
    kept = np.random.default_rng(5).random(len(dut(swung)["t"])) > 0.3
    observed = observe(rows(swung, "dut", kept))
    (loss,) = [one for one in observed.timing if one.effect == "link.frame_loss"]
    assert loss.value == pytest.approx(0.3, abs=4 * loss.standard_uncertainty)
    assert f"frames {int((~kept[kept.argmax() :]).sum())} lost" in said(observed)
    gyro = observed.outputs["gyro"].residual_si
    assert np.isfinite(gyro).all(axis=1).mean() == pytest.approx(0.7, abs=0.02)
    assert np.nanstd(gyro[:, 2]) < 0.5 * DEG


def test_a_rate_other_than_stated_is_said() -> None:
    still = recorded("mems_ahrs", "static", values={"duration_s": 5.0}, seed=3, serial="U-0007")
    for stated, told in ((200.0, False), (100.0, True)):
        observed = observe(dataclasses.replace(still, test={**still.test, "rate_hz": stated}))
        assert ("sample rate 0 by the stamps 200 Hz, by the test 100 Hz" in said(observed)) == told


def test_plain_numbers_without_a_scale_are_not_guessed() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    wave = 1000.0 * np.sin(t)
    counts = Stream(
        "dut",
        "dut",
        "t",
        {"t": "s", **dict.fromkeys(("mag_x", "mag_y", "mag_z"), "1")},
        {"t": t, "mag_x": wave, "mag_y": wave, "mag_z": wave},
    )
    recording = Recording("own", {"serial": "1"}, {"profile": "hand"}, {"dut": counts})
    with pytest.raises(DiagnosisError, match="no scale is believed"):
        observe(recording)
