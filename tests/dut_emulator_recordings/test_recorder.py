"""The recorder: what a recording says and does not say, on which clock, in how much memory."""

import dataclasses
import json

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession, record_to, recorded
from dut_emulator.recording.recording_files import write_recording
from dut_emulator.twin import Twin
from protocol.adapters.recording_forms import read_recording
from protocol.errors import TestloomError
from protocol.recording_checks import equal_recordings
from protocol.stream_files import STREAM_FORMATS
from tests.dut_emulator_recordings.conftest import STAND_RATE_HZ, UNIT_RATE_HZ


def test_a_recording_has_the_samples_and_says_who_and_how(plain):
    recording = recorded(plain, "plain_spin", values={"rate": 30.0}, serial="U-0042", run=3)
    dut, stand, mark = (recording.streams[name] for name in ("dut", "stand", "mark"))
    np.testing.assert_array_equal(dut.columns["t"], np.arange(2001) / UNIT_RATE_HZ)
    assert dut.columns["counter"].dtype == np.int32
    np.testing.assert_array_equal(stand.columns["t"], np.arange(801) / STAND_RATE_HZ)
    np.testing.assert_array_equal(stand.columns["rate_z"], 30.0)
    np.testing.assert_array_equal(mark.columns["t"], [0.0, 0.5, 1.0, 1.5])
    assert (dut.clock, stand.clock, mark.clock) == ("dut", "stand", "stand")
    assert recording.recording_id == "plain_unit-U-0042-plain_spin-m1-r3"
    assert recording.unit == {"serial": "U-0042", "product": "plain_unit"}
    assert recording.test == {
        "profile": "plain_spin",
        "run": 3,
        "mount": "m1",
        "started_at": "2026-01-01T00:00:00Z",
        "values": {"rate": 30.0, "duration": 2.0},
        "value_units": {"rate": "deg/s", "duration": "s"},
        "triggered": True,
    }
    assert recording.stand == {
        "id": "pt-1",
        "kind": "plain_table",
        "calibration_due": "2026-06-30",
        "emulated": True,
    }
    assert recording.site["field_uT"] == [27.0, -1.5, 45.0]  # north, east, down
    assert recording.believed["gyro"]["unit"] == "deg/s"


def test_a_trigger_joins_the_clocks_and_nothing_tells_their_offset_without(plain):
    apart = recorded(plain, "plain_spin", triggered=False, clock_offset_s=0.013)
    assert apart.streams["dut"].columns["t"][0] == 0.0
    np.testing.assert_allclose(apart.streams["stand"].columns["t"][:2], [0.013, 0.0155], rtol=1e-12)
    np.testing.assert_allclose(apart.streams["mark"].columns["t"][:2], [0.013, 0.513], rtol=1e-12)
    assert apart.test["triggered"] is False
    assert "0.013" not in json.dumps([dict(apart.test), dict(apart.stand), dict(apart.extra)])


def test_the_truth_is_told_apart_from_the_recording(plain, tmp_path):
    twin = Twin("plain_unit", (effect_named("gyro.bias", bias_si=(0.125, 0.0, 0.0)),))
    session = RecordingSession(RecordingOrder(plain, "plain_spin", twin=twin, triggered=False))
    (folder, _, _) = write_recording(session, tmp_path / "out", truth=tmp_path / "truth.json")
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["unit"]["effects"][0]["parameters"]["bias_si_x"] == {"value": 0.125, "unit": "rad/s"}
    assert truth["stand"]["effects"][0]["effect"] == "stand.remount_misalignment"
    assert truth["stand_clock_ahead_s"] == 0.013
    told = (folder / "recording.json").read_text()
    assert "gyro.bias" not in told
    assert "remount" not in told
    with pytest.raises(TestloomError, match="something of this name already"):
        write_recording(session, tmp_path / "again", truth=tmp_path / "truth.json")
    assert not (tmp_path / "again").exists()
    inside = tmp_path / "again" / session.description.recording_id / "truth.json"
    with pytest.raises(TestloomError, match="cannot be a part of the recording"):
        write_recording(session, tmp_path / "again", truth=inside)


def test_of_two_effects_with_one_name_the_units_is_the_truth(plain):
    twin = Twin("", (effect_named("stand.remount_misalignment", "gyro", rotation_rad=(0.0, 0.0, 0.0)),))
    assert RecordingSession(RecordingOrder(plain, "plain_spin", twin=twin)).truth()["stand"]["effects"] == []


def test_noise_is_the_runs_own_and_a_remount_turns_the_unit_anew(plain):
    order = RecordingOrder(plain, "plain_spin", seed=4)
    orders = [order]
    for changed in ({"run": 2}, {"serial": "U-2"}, {"seed": 5}, {"mount": "m2"}):
        orders.append(dataclasses.replace(order, **changed))
    sessions = [RecordingSession(one) for one in orders]
    firsts = [next(session.chunks())[1]["dut"]["gyro_z"][0] for session in sessions]
    assert len(set(firsts)) == len(firsts)
    again = next(RecordingSession(order).chunks())[1]["dut"]["gyro_z"][0]
    assert again == firsts[0]
    first, *others, remounted = [session.unit.stand_effects[0] for session in sessions]
    assert all(effect == first for effect in others)
    assert remounted != first


@pytest.mark.parametrize("stream_format", STREAM_FORMATS)
def test_both_forms_hold_what_is_in_memory(plain, tmp_path, stream_format):
    session = RecordingSession(RecordingOrder(plain, "plain_spin", sample_type="float32"))
    folder, mcap = write_recording(session, tmp_path, stream_format=stream_format, chunk_samples=300)
    whole = recorded(plain, "plain_spin", sample_type="float32")
    assert whole.streams["dut"].columns["gyro_z"].dtype == np.float32
    assert whole.streams["dut"].columns["t"].dtype == np.float64
    assert equal_recordings(read_recording(folder), whole)
    assert equal_recordings(read_recording(mcap), whole)
    with pytest.raises(TestloomError, match="something of this name already"):
        write_recording(session, tmp_path)


def test_an_hour_is_never_in_memory_at_once(plain):
    class Counting:
        def __init__(self):
            self.most = 0
            self.rows = {"dut": 0, "stand": 0, "mark": 0}

        def append(self, stream, columns):
            self.most = max(self.most, *(len(column) for column in columns.values()))
            self.rows[stream] += len(columns["t"])

    session = RecordingSession(RecordingOrder(plain, "plain_spin", values={"duration": 3600.0}))
    counting, reached = Counting(), []
    record_to(session, [counting], reached.append, chunk_samples=20_000)
    assert counting.rows == {"dut": 3_600_001, "stand": 1_440_001, "mark": 7200}
    assert counting.most <= 20_001  # the very first sample is one more
    assert reached == sorted(reached)
    assert reached[-1] == 3600.0


def test_a_unit_may_be_sampled_faster_than_it_sends():
    """White noise of one density: five times the rate has √5 times the deviation from sample to sample."""
    order = {"values": {"duration_s": 20.0}, "seed": 3}
    usual, fast = (recorded("gnc_module", "static", rate_hz=rate, **order) for rate in (None, 1000.0))
    assert fast.test["rate_hz"] == 1000.0
    assert "rate_hz" not in usual.test
    steps = {}
    for recording, rate_hz in ((usual, 200.0), (fast, 1000.0)):
        columns = recording.streams["dut"].columns
        np.testing.assert_allclose(np.diff(columns["t"]), 1 / rate_hz, rtol=1e-3)
        steps[rate_hz] = np.std(np.diff(columns["acc_x"]))
    assert steps[1000.0] / steps[200.0] == pytest.approx(5**0.5, rel=0.05)
    with pytest.raises(TestloomError, match="frames with a rate of their own"):
        RecordingSession(RecordingOrder("fog", "impact", rate_hz=1000.0))


def test_an_overdue_calibration_is_in_the_recording_and_warned_of(plain):
    good = RecordingSession(RecordingOrder(plain, "plain_spin", started_at="2026-06-30T23:59:59Z"))
    assert good.warnings == ()
    late = RecordingSession(RecordingOrder(plain, "plain_spin", started_at="2026-07-01T00:00:00Z"))
    assert late.description.stand["calibration_overdue"] is True
    assert late.warnings == ("The calibration of stand pt-1 was due on 2026-06-30.",)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"profile": "static"}, "A plain_unit cannot undergo the profile 'static'"),
        ({"profile": "dance"}, "There is no profile 'dance'"),
        ({"product": "rocket"}, "There is no product 'rocket'"),
        ({"values": {"rate": 101.0}}, "rate cannot be 101 deg/s"),
        ({"values": {"speed": 1.0}}, "has no parameter 'speed'"),
        ({"twin": Twin("fog")}, "The twin is one of a fog, not of a plain_unit"),
        ({"started_at": "yesterday"}, "'yesterday' is no date and time"),
        ({"powered_before_s": -1.0}, "powered_before_s cannot be '-1.0'"),
        ({"clock_offset_s": float("nan")}, "clock_offset_s cannot be 'nan'"),
        ({"run": 10**20}, "run cannot be '1000"),
        ({"seed": -1}, "seed cannot be '-1'"),
        ({"seed": 2**63}, "seed cannot be '9223372036854775808'"),
        ({"stand_seed": -1}, "stand_seed cannot be '-1'"),
        ({"serial": "../U-0001"}, "serial cannot be '../U-0001'"),
        ({"serial": ""}, "serial cannot be ''"),
        ({"mount": ".."}, "mount cannot be '..'"),
        ({"rate_hz": 0.0}, "rate_hz cannot be '0.0'"),
        ({"rate_hz": float("nan")}, "rate_hz cannot be 'nan'"),
    ],
)
def test_what_cannot_be_recorded_is_refused_before_anything_runs(plain, changed, says):
    order = dataclasses.replace(RecordingOrder(plain, "plain_spin"), **changed)
    with pytest.raises(TestloomError, match=says):
        RecordingSession(order)


def test_a_unit_that_fails_in_the_middle_leaves_no_file(plain, tmp_path, monkeypatch):
    session = RecordingSession(RecordingOrder(plain, "plain_spin"))

    def stop(reached_s: float) -> None:
        if reached_s >= 1.0:
            raise KeyboardInterrupt

    truth = tmp_path / "truth.json"
    with pytest.raises(KeyboardInterrupt):
        write_recording(session, tmp_path / "out", truth=truth, progress=stop, chunk_samples=300)
    assert list((tmp_path / "out").iterdir()) == []
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_the_quicker_of_two_recordings_of_one_name_stays_as_it_is(plain, tmp_path):
    slow = RecordingSession(RecordingOrder(plain, "plain_spin"))
    quick = RecordingSession(RecordingOrder(plain, "plain_spin", seed=2))

    def overtake(reached_s: float) -> None:
        if reached_s >= slow.duration_s and not (tmp_path / quick.description.recording_id).exists():
            write_recording(quick, tmp_path)

    with pytest.raises(TestloomError, match="something of this name already"):
        write_recording(slow, tmp_path, progress=overtake)
    name = quick.description.recording_id
    assert {path.name for path in tmp_path.iterdir()} == {name, f"{name}.mcap"}
    assert equal_recordings(read_recording(tmp_path / name), read_recording(tmp_path / f"{name}.mcap"))


def test_clocks_started_by_hand_look_like_an_error_of_attitude():
    """Paper 2, swing test: 13 ms at 200 °/s are 2.6°, beside which the unit's own error disappears."""
    angles = []
    for triggered in (True, False):
        swing = recorded("mems_ahrs", "swing", values={"cycles": 2.0}, triggered=triggered)
        unit, stand = swing.streams["dut"].columns, swing.streams["stand"].columns
        angles.append(np.interp(unit["t"], stand["t"], stand["angle_inner"]))
        assert np.abs(stand["rate_x"]).max() == pytest.approx(200.0, rel=1e-3)
    assert np.abs(angles[1] - angles[0]).max() == pytest.approx(2.6, rel=1e-3)
