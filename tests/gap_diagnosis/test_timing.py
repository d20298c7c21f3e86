"""Timing: what the emulator's link does is found within its stated uncertainty, and nothing else is."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import Twin
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.frames import stamp_jumps
from gap_diagnosis.observation import Observation, TimingFinding
from gap_diagnosis.observing import observe
from gap_diagnosis.unit_rows import unit_rows, unwrapped_counter
from protocol.recordings import Recording, Stream

DEG = math.pi / 180
PLAIN = {"misalignment", "scale_factor_error", "bias", "white_noise", "bias_instability", "bandwidth"}
CERTAIN = 12.0
RATE_NAMES = ("rate_x", "rate_y", "rate_z")
GYRO_NAMES = ("gyro_x", "gyro_y", "gyro_z")


def plain_twin(serial: str = "U-0007") -> Twin:
    """A unit whose link does nothing."""
    drawn = product_named("mems_ahrs").twin(3, serial)
    return Twin(drawn.product, tuple(e for e in drawn.effects if e.word in PLAIN | {"quantization"}))


def with_link(word: str | None, serial: str = "U-0007", **parameters: float) -> Twin:
    twin = plain_twin(serial)
    for sensor in ("gyro", "acc"):
        if word is not None:
            effect: Any = effect_named(f"link.{word}", sensor)
            twin = twin.with_effect(dataclasses.replace(effect, **parameters))
    return twin


def seen(twin: Twin, profile: str = "swing", serial: str = "U-0007", **ordered: Any) -> Observation:
    return observe(recorded("mems_ahrs", profile, twin=twin, seed=3, serial=serial, **ordered))


def certain(observed: Observation) -> dict[str, list[TimingFinding]]:
    found: dict[str, list[TimingFinding]] = {}
    for finding in observed.timing:
        if finding.log_likelihood_ratio > CERTAIN:
            found.setdefault(finding.effect, []).append(finding)
    return found


def random_motion(seconds: float, rate_hz: float, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Times and (n, 3) rates in °/s with content up to 5 Hz: no two stretches are alike."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    tones = rng.uniform(0.2, 5.0, (3, 12)), rng.uniform(0, 2 * math.pi, (3, 12))
    return t, np.stack(
        [(10 * np.sin(2 * math.pi * f * t[:, None] + p)).sum(axis=1) for f, p in zip(*tones, strict=True)],
        axis=1,
    )


def sampled(
    stamps: np.ndarray, taken: np.ndarray, stand_offset_s: float = 0.0, seed: int = 2, **more: Any
) -> Recording:
    """The unit's samples of `random_motion`, taken at `taken` (s) and stamped `stamps`."""
    t, rates = random_motion(float(taken[-1]) + 1.0, 500.0, seed)
    noise = np.random.default_rng(seed).normal(0, 0.05, (len(taken), 3))
    shown = np.stack([np.interp(taken, t, rates[:, axis]) for axis in range(3)], axis=1) + noise
    dut = Stream(
        "dut",
        "dut",
        "t",
        {"t": "s", **dict.fromkeys(GYRO_NAMES, "deg/s"), **dict.fromkeys(more, "1")},
        {"t": stamps, **dict(zip(GYRO_NAMES, shown.T, strict=True)), **more},
    )
    stand = Stream(
        "stand",
        "stand",
        "t",
        {"t": "s", **dict.fromkeys(RATE_NAMES, "deg/s")},
        {"t": t + stand_offset_s, **dict(zip(RATE_NAMES, rates.T, strict=True))},
    )
    return Recording(
        "own-1", {"serial": "U-1", "product": "own"}, {"profile": "own"}, {"dut": dut, "stand": stand}
    )


@pytest.mark.parametrize(
    ("word", "parameters", "tolerance"),
    [
        (None, {}, 0.0),
        ("fixed_delay", {"delay_s": 2.5e-3}, 0.0),
        ("clock_drift", {"relative_rate": 40e-6}, 0.0),
        ("timestamp_jitter", {"deviation_s": 1e-3}, 0.3),  # with what the quanta and the slow noise add
        ("frame_loss", {"probability": 0.05}, 0.0),
        ("duplicate_frames", {"probability": 0.02}, 0.0),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_the_link_does_is_found_and_nothing_else(
    word: str | None, parameters: dict[str, float], tolerance: float
) -> None:
    found = certain(seen(with_link(word, **parameters)))
    assert set(found) == ({f"link.{word}"} if word else set())
    for name, truth in parameters.items():
        findings = found[f"link.{word}"]
        assert {finding.sensors for finding in findings} == {("gyro",), ("acc",)}
        for finding in findings:
            allowed = max(4.0 * finding.standard_uncertainty, tolerance * truth)
            assert (finding.parameter, finding.value) == (name, pytest.approx(truth, abs=allowed))
            assert finding.standard_uncertainty < 0.2 * truth


def test_a_word_that_wraps_round_is_found_and_set_aside() -> None:
    effect: Any = effect_named("link.counter_wrap", "gyro")
    twin = plain_twin().with_effect(dataclasses.replace(effect, half_span_si=1.5))
    observed = seen(twin, "rate_staircase", values={"dwell_s": 1.0})
    findings = certain(observed)["link.counter_wrap"]
    assert len(findings) == 3
    for finding in findings:
        assert finding.value == pytest.approx(1.5, abs=5 * finding.standard_uncertainty + 1e-3)
    gyro = observed.outputs["gyro"]
    assert np.nanmax(np.abs(gyro.residual_si)) < 0.1


def test_epochs_that_have_nothing_to_do_with_each_other_are_joined_by_the_motion() -> None:
    taken = np.arange(0.5, 30.0, 0.01)
    observed = observe(sampled(taken + 1264.0, taken, stand_offset_s=949113.25))
    assert observed.aligned_by_s == pytest.approx(949113.25 - 1264.0, abs=5e-5)
    assert "link.fixed_delay" not in certain(observed)
    assert any(one.what == "clock" and "nothing is said of a delay" in one.why for one in observed.set_aside)
    assert np.nanstd(observed.outputs["gyro"].residual_si) == pytest.approx(0.05 * DEG, rel=0.05)
    by_hand = seen(plain_twin(), triggered=False)
    assert by_hand.aligned_by_s == pytest.approx(0.013, abs=5e-5)
    far = sampled(taken, taken, stand_offset_s=7.5)  # the spans overlap, the motion does not
    assert observe(far).aligned_by_s == pytest.approx(7.5, abs=5e-5)


def test_a_delay_of_many_samples_and_one_ahead_are_told_on_a_clock_that_belongs() -> None:
    taken = np.arange(1.0, 40.0, 0.01)
    for late_s in (0.2, -0.03):
        (finding,) = certain(observe(sampled(taken + late_s, taken)))["link.fixed_delay"]
        assert finding.value == pytest.approx(late_s, abs=max(4 * finding.standard_uncertainty, 2e-5))


def test_a_clock_that_was_set_is_refused() -> None:
    taken = np.arange(1.0, 60.0, 0.01)
    stamps = taken + 0.03 * (taken > 25.0)
    with pytest.raises(DiagnosisError, match=r"clock jumps by 0\.0(29|30)") as caught:
        observe(sampled(stamps, taken))
    assert "split" in caught.value.remedy
    counter = np.arange(len(taken))
    rows = unit_rows(sampled(stamps + 0.5 * (taken > 30.0), taken, counter=counter))
    note = stamp_jumps(rows, stamps + 0.5 * (taken > 30.0))
    assert note is not None
    assert note.count == 2


def test_periodic_motion_cannot_join_two_epochs() -> None:
    t = np.arange(0.0, 30.0, 0.01)
    wave = 10.0 * np.sin(2 * math.pi * 0.5 * t)
    recording = sampled(t[100:-100], t[100:-100])
    dut = dict(recording.streams["dut"].columns) | dict.fromkeys(GYRO_NAMES, wave[100:-100])
    stand = {"t": t + 5000.0, **dict.fromkeys(RATE_NAMES, wave)}
    streams = {
        "dut": dataclasses.replace(recording.streams["dut"], columns=dut),
        "stand": dataclasses.replace(recording.streams["stand"], columns=stand),
    }
    with pytest.raises(DiagnosisError, match="no time in common"):
        observe(dataclasses.replace(recording, streams=streams))


def test_frames_that_a_counter_of_eight_bits_misses_are_lost() -> None:
    """Also around its wrap, and where the stamps alone would not tell."""
    taken = np.arange(1.0, 21.0, 0.01)
    kept = np.random.default_rng(4).random(len(taken)) > 0.3
    counter = (np.arange(len(taken)) % 256).astype(np.uint8)
    recording = sampled(taken[kept], taken[kept], counter=counter[kept])
    observed = observe(recording)
    (finding,) = certain(observed)["link.frame_loss"]
    inside = kept[np.flatnonzero(kept)[0] : np.flatnonzero(kept)[-1] + 1]
    assert finding.value == pytest.approx(1 - inside.mean(), abs=1e-12)
    assert len(observed) == len(inside)  # a row for each frame, lost or not
    assert np.isnan(observed.outputs["gyro"].values_si[~inside]).all()
    assert np.diff(observed.stimulus.time_s) == pytest.approx(0.01)
    assert unwrapped_counter(np.array([254, 255, 0, 1, 2], dtype=np.uint8)).tolist() == [
        254,
        255,
        256,
        257,
        258,
    ]  # type: ignore[union-attr]
    assert unwrapped_counter(np.array([7, 7, 7, 7])) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("word", "parameters"), [("fixed_delay", {"delay_s": 1e-3}), ("clock_drift", {"relative_rate": 30e-6})]
)
def test_stated_uncertainties_hold(word: str, parameters: dict[str, float]) -> None:
    """Of 40 units: within 2 of its standard uncertainties in 95 %, and not much too wide either."""
    ((name, truth),) = parameters.items()
    away: list[float] = []
    for number in range(40):
        serial = f"U-{number + 1:04d}"
        for finding in seen(with_link(word, serial, **parameters), serial=serial).timing:
            if finding.parameter == name:
                away.append((finding.value - truth) / finding.standard_uncertainty)
    assert len(away) >= 70
    assert np.mean(np.abs(away) < 2.0) > 0.88
    assert np.std(away) > 0.5


@pytest.mark.slow
def test_a_link_that_does_nothing_is_not_accused() -> None:
    """Of 40 units, swung: a handful of findings at most, and these small."""
    accused = 0
    for number in range(40):
        serial = f"U-{number + 1:04d}"
        accused += bool(certain(seen(plain_twin(serial), serial=serial)))
    assert accused <= 1
