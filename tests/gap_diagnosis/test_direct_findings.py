"""What the samples show by themselves: found with the right number, and never on clean recordings."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dut_emulator.recording.recorder import recorded
from gap_diagnosis.direct_findings import certain_findings, oddities_of
from gap_diagnosis.lattice import lattice_of
from gap_diagnosis.observation import Observation, TimingFinding
from gap_diagnosis.observing import observe
from gap_diagnosis.spectral_lines import lines_taken_off
from tests.gap_diagnosis.own_links import (
    DEG,
    NOISE_SI,
    RATE_HZ,
    Samples,
    motion,
    recording,
    rounded,
    samples,
    wrapped,
)

Fault = Callable[[Samples], None]


def seen(fault: Fault | None = None, seed: int = 1, seconds: float = 30.0, **made: Any) -> Observation:
    moved = motion(seed, at_rest=made.pop("at_rest", 0.0))
    sent = samples(moved, seconds, seed, made.pop("jitter_s", 0.0))
    if fault is not None:
        fault(sent)
    made = {key: value(sent) if callable(value) else value for key, value in made.items()}
    return observe(recording(moved, sent, number=seed, **made))


def found(*observations: Observation) -> dict[str, TimingFinding]:
    return {one.effect: one for one in certain_findings(lines_taken_off(observations), frozenset())}


def odd(observation: Observation) -> list[str]:
    return [one.description for one in oddities_of([observation], frozenset())]


def quantised(sensor: str, quantum: float) -> Fault:
    def fault(sent: Samples) -> None:
        sent.values[sensor] = rounded(sent.values[sensor], quantum)

    return fault


@pytest.mark.parametrize(
    ("sensor", "quantum", "believed"),
    [("gyro", 0.2 * DEG, None), ("gyro", 0.02 * DEG, 0.005), ("acc", 0.1, None), ("gyro", 4 * DEG, 0.005)],
)
def test_a_lattice_coarser_than_believed_is_found_with_its_quantum(
    sensor: str, quantum: float, believed: float | None
) -> None:
    belief = {sensor: {"quantum": believed}} if believed else None
    observed = seen(quantised(sensor, quantum), believed=belief)
    findings = found(observed)
    assert list(findings) == [f"{sensor}.quantization"]
    assert findings[f"{sensor}.quantization"].value == pytest.approx(quantum, rel=1e-7)
    assert observed.outputs[sensor].quantum_si == pytest.approx(quantum, rel=1e-7)  # type: ignore[index]


@pytest.mark.parametrize(("quantum", "believed"), [(0.005 * DEG, 0.005), (1e-6, None), (0.01 * DEG, None)])
def test_rounding_that_is_believed_or_adds_nothing_is_no_gap(quantum: float, believed: float | None) -> None:
    belief = {"gyro": {"quantum": believed}} if believed else None
    assert not found(seen(quantised("gyro", quantum), believed=belief))


def test_only_a_lattice_is_one() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(0, 1, 3000)
    assert lattice_of(values) is None
    coarse = np.rint(values / 0.3) * 0.3
    assert lattice_of(coarse + 0.01).quantum_si == pytest.approx(0.3)  # type: ignore[union-attr]
    assert lattice_of(coarse + rng.uniform(-0.1, 0.1, 3000)) is None
    text = np.round(coarse * 180 / math.pi, 4) * math.pi / 180  # other units, written in a few digits
    assert lattice_of(text).quantum_si == pytest.approx(0.3, rel=1e-4)  # type: ignore[union-attr]


def toned(frequency_hz: float, d: float, axes: tuple[int, ...] = (1,)) -> Fault:
    def fault(sent: Samples) -> None:
        n, phase = len(sent.time_s), sent.rng.uniform(0, 6.0)
        size = d * math.sqrt(2.0 / (n * len(axes))) * NOISE_SI["gyro"]
        for axis in axes:
            wave = np.cos(2 * math.pi * frequency_hz * sent.time_s + phase)
            sent.values["gyro"][:, axis] += size * wave

    return fault


@pytest.mark.parametrize("axes", [(1,), (0, 1, 2)])
def test_a_vibration_beyond_half_the_sampling_rate_is_a_line(axes: tuple[int, ...]) -> None:
    """At 113.27 Hz, sampled at 100: seen at 13.27 Hz, d = 10 in each of two recordings."""
    two = [seen(toned(RATE_HZ + 13.27, 10.0, axes), seed) for seed in (1, 2)]
    (finding,) = found(*two).values()
    assert finding.effect == "link.aliasing"
    assert finding.value == pytest.approx(RATE_HZ - 13.27, abs=4 * finding.standard_uncertainty)
    assert "113.27" in finding.description
    assert finding.channels == tuple(f"gyro_{'xyz'[axis]}" for axis in axes)
    before, after = two[0], lines_taken_off(two)[0]
    power = [np.nansum(one.outputs["gyro"].residual_si[:, 1] ** 2) for one in (before, after)]
    expected = 100.0 / len(axes) * NOISE_SI["gyro"] ** 2
    assert power[0] - power[1] == pytest.approx(expected, rel=0.5)


def test_what_motion_leaves_is_no_line() -> None:
    """Tones of the motion through an error of even order, a cubic one and a lag."""

    def fault(sent: Samples) -> None:
        rates = sent.values["gyro"]
        rates += 5e-3 * np.abs(rates) + 0.02 * rates**3 + 0.02 * rates**2
        rates[1:] += 0.3 * np.diff(rates, axis=0)

    assert "link.aliasing" not in found(*(seen(fault, seed) for seed in (1, 2)))


def test_a_line_that_must_not_be_named_is_described() -> None:
    observed = lines_taken_off([seen(toned(13.27, 15.0))])
    (oddity,) = oddities_of(observed, frozenset({"link.aliasing"}))
    assert oddity.description.startswith("A line at 13.27")
    assert oddity.channel == "gyro_y"
    assert not certain_findings(observed, frozenset({"link.aliasing"}))


def test_a_stop_inside_the_range_is_found_and_set_aside() -> None:
    def fault(sent: Samples) -> None:
        sent.values["gyro"] = np.clip(sent.values["gyro"], -70 * DEG, 70 * DEG)

    observed = seen(fault, believed={"gyro": {"range": 250.0}})
    (finding,) = found(observed).values()
    assert (finding.effect, finding.parameter) == ("gyro.saturation", "range_si")
    assert finding.value == pytest.approx(70 * DEG, abs=4 * finding.standard_uncertainty)
    assert np.nanmax(np.abs(observed.outputs["gyro"].values_si)) < 70 * DEG


def test_a_stop_at_one_side_is_not_in_the_catalogue() -> None:
    def fault(sent: Samples) -> None:
        sent.values["gyro"][:, 0] = np.minimum(sent.values["gyro"][:, 0], 60 * DEG)

    observed = seen(fault)
    assert not found(observed)
    assert any("gyro_x clips at one side" in text for text in odd(observed))


def repeated(share: float, axis: int | None = None) -> Fault:
    def fault(sent: Samples) -> None:
        for row in np.flatnonzero(sent.rng.random(len(sent.time_s)) < share):
            for sensor, values in sent.values.items():
                if row and (axis is None or sensor == "gyro"):
                    columns = slice(None) if axis is None else axis
                    values[row, columns] = values[row - 1, columns]

    return fault


def test_frames_that_repeat_are_the_links_and_a_channel_that_does_is_not() -> None:
    findings = found(seen(repeated(0.03)))
    assert list(findings) == ["link.duplicate_frames"]
    finding = findings["link.duplicate_frames"]
    assert finding.value == pytest.approx(0.03, abs=4 * finding.standard_uncertainty)
    held = seen(repeated(0.03, axis=1))
    assert not found(held)
    (said,) = odd(held)
    assert said.startswith("gyro_y holds its last value")


def test_frames_that_were_sent_twice_are_told_by_their_number() -> None:
    """With their time and values: nothing is lost, and nothing of it shows beside the prediction."""
    recording = recorded("gnc_module", "static", rate_hz=50.0, values={"duration_s": 20.0})
    stream = recording.streams["dut"]
    again = np.random.default_rng(4).random(len(stream)) < 0.02
    columns = {name: np.repeat(values, 1 + again) for name, values in stream.columns.items()}
    twice = dataclasses.replace(stream, columns=columns)
    observed = observe(dataclasses.replace(recording, streams={**recording.streams, "dut": twice}))
    finding = found(observed)["link.duplicate_frames"]
    assert finding.value == pytest.approx(again.sum() / len(columns["t"]))
    missing = np.isnan(observed.outputs["gyro"].values_si).all(axis=1)
    assert missing.sum() == again.sum()


def counter(bits: int) -> Callable[[Samples], np.ndarray]:
    return lambda sent: ((2**bits - 500 + np.arange(len(sent.time_s))) % 2**bits).astype(float)


@pytest.mark.parametrize("bits", [8, 16])
def test_lost_rows_are_counted_through_a_counters_end(bits: int) -> None:
    lost = seen(keep=lambda sent: sent.rng.random(len(sent.time_s)) > 0.02, counter=counter(bits))
    finding = found(lost)["link.frame_loss"]
    assert finding.value == pytest.approx(0.02, abs=4 * finding.standard_uncertainty)
    assert not found(seen(counter=counter(bits)))  # a counter's own end is no gap


def test_values_that_come_out_at_the_other_end_are_found() -> None:
    def fault(sent: Samples) -> None:
        sent.values["gyro"] = wrapped(sent.values["gyro"], 70 * DEG)

    finding = found(seen(fault))["link.counter_wrap"]
    assert finding.value == pytest.approx(70 * DEG, abs=5 * finding.standard_uncertainty + 1e-4)


@pytest.mark.parametrize("jitter_s", [2e-4, 2e-3])
def test_jitter_is_found_under_swing(jitter_s: float) -> None:
    finding = found(seen(jitter_s=jitter_s, seconds=60.0))["link.timestamp_jitter"]
    assert finding.value == pytest.approx(jitter_s, rel=0.1)


def test_a_step_at_rest_is_described() -> None:
    def fault(sent: Samples) -> None:
        sent.values["gyro"][sent.time_s > 131.0, 0] += 0.05 * DEG

    (said,) = odd(seen(fault, seconds=240.0, at_rest=300.0))
    assert "on gyro_x at 131" in said


@pytest.mark.slow
def test_clean_recordings_show_nothing() -> None:
    """Of 120: with and without quanta, counters, rests. Lines have p < e^-6: 0.3 are expected by chance.

    That of seed 59 is one: its white noise, as drawn, has a periodogram of 21.9 there.
    """
    accused: list[str] = []
    for seed in range(120):
        believed = {"gyro": {"quantum": 0.01}, "acc": {"quantum": 0.002}} if seed % 2 else None

        def fault(sent: Samples, coarse: bool = bool(seed % 2)) -> None:
            if coarse:
                quantised("gyro", 0.01 * DEG)(sent)
                quantised("acc", 0.002)(sent)

        more = {"counter": counter(8)} if seed % 4 == 3 else {}
        observed = seen(fault, seed, 60.0, believed=believed, at_rest=30.0 * (seed % 3 == 0), **more)
        accused += [*found(observed), *odd(observed)]
    assert len(accused) <= 1
