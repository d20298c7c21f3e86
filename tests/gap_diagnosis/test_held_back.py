"""What is not claimed, though a line, a drift or an extreme is there; and a stop that nobody predicts."""

import dataclasses
import math

import numpy as np
import pytest

from gap_diagnosis.candidates import Trial
from gap_diagnosis.direct_findings import certain_findings
from gap_diagnosis.observation import NoiseBelief, Observation, TimingFinding
from gap_diagnosis.observing import observe
from gap_diagnosis.renewal import renews_by_itself
from gap_diagnosis.spectral_lines import lines_taken_off
from gap_diagnosis.unknown_drift import drift_noted, without_drifts
from protocol.recordings import Recording, Stream
from tests.gap_diagnosis.own_links import DEG, RATE_HZ, Samples, motion, recording, samples


def seen(seed: int, fault, seconds: float = 60.0, **made) -> Observation:
    moved = motion(seed)
    sent = samples(moved, seconds, seed, 0.0)
    fault(sent)
    return observe(recording(moved, sent, number=seed, **made))


def named(*observations: Observation) -> dict[str, TimingFinding]:
    return {one.effect: one for one in certain_findings(lines_taken_off(observations), frozenset())}


def held_at(own_hz: float):
    def fault(sent: Samples) -> None:
        """Each frame has the newest value of a sensor that renews itself at `own_hz`."""
        newest = np.floor(np.arange(len(sent.time_s)) * own_hz / RATE_HZ + 1e-9)
        first = np.rint(np.ceil(newest * RATE_HZ / own_hz)).astype(int)
        sent.values["gyro"] = sent.values["gyro"][np.minimum(first, len(first) - 1)]

    return fault


def test_the_rate_at_which_a_sensor_renews_itself_is_no_tone() -> None:
    observed = seen(3, held_at(37.0))
    assert renews_by_itself(observed, "gyro")
    assert not renews_by_itself(observed, "acc")
    assert "link.aliasing" not in named(observed)


def test_copies_at_random_are_no_second_clock() -> None:
    def copied(sent: Samples) -> None:
        for row in np.flatnonzero(sent.rng.random(len(sent.time_s)) < 0.1):
            sent.values["gyro"][row] = sent.values["gyro"][max(row - 1, 0)]

    assert not renews_by_itself(seen(3, copied), "gyro")


def toned(frequency_hz: float, wander_hz: float):
    def fault(sent: Samples) -> None:
        t = sent.time_s
        phase = 2 * math.pi * frequency_hz * t + wander_hz * 15.0 * np.sin(2 * math.pi * t / 30.0)
        sent.values["gyro"][:, 1] += 0.02 * DEG * np.cos(phase)

    return fault


@pytest.mark.parametrize(("wander_hz", "is_named"), [(0.0, True), (0.05, False)])
def test_a_line_that_wanders_is_no_tone_of_one_frequency(wander_hz: float, is_named: bool) -> None:
    observed = [seen(seed, toned(31.7, wander_hz), 120.0) for seed in (1, 2)]
    assert ("link.aliasing" in named(*observed)) == is_named
    notes = [note.why for one in lines_taken_off(observed) for note in one.set_aside]
    assert any("samples of one rate do not tell" in why for why in notes) == is_named


def spun(level_dps: tuple[float, float, float]) -> Recording:
    """A rest that the stand reports, then turns by hand beyond its levels that nothing reports."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 60.0, 0.01)
    moving = time_s > 30.0
    rates = np.stack([900.0 * np.sin(2 * np.pi * f * time_s) for f in (0.31, 0.23, 0.17)], axis=1)
    rates = np.where(moving[:, None], rates, 0.0) + 0.05 * rng.standard_normal((len(time_s), 3))
    rates = np.clip(rates, [-one for one in level_dps], level_dps)
    dut = {"t": time_s, **{f"gyro_{a}": rates[:, k] for k, a in enumerate("xyz")}}
    rest_s = np.arange(0.0, 30.0, 0.1)
    stand = {"t": rest_s, **{f"rate_{a}": np.zeros(300) for a in "xyz"}}
    units = {"t": "s", **{f"gyro_{a}": "deg/s" for a in "xyz"}}
    stand_units = {"t": "s", **{f"rate_{a}": "deg/s" for a in "xyz"}}
    return Recording(
        "spun",
        {"serial": "U-1", "product": "own"},
        {"profile": "by_hand"},
        {
            "dut": Stream("dut", "dut", "t", units, dut),
            "stand": Stream("stand", "stand", "t", stand_units, stand),
        },
        believed={"gyro": {"unit": "deg/s", "range": 2000.0}},
    )


def test_an_axis_that_stops_below_another_axis_motion_is_named_alone() -> None:
    (finding,) = observe(spun((2000.0, 400.0, 2000.0))).timing
    assert (finding.effect, finding.channels) == ("gyro.saturation", ("gyro_y",))
    assert finding.value == pytest.approx(400.0 * DEG, rel=1e-6)


def test_turning_points_of_a_motion_are_no_stops() -> None:
    assert observe(spun((2000.0, 2000.0, 2000.0))).timing == ()


def test_the_end_of_a_believed_range_is_said_and_is_no_gap() -> None:
    wide = spun((800.0, 800.0, 800.0))
    same = dataclasses.replace(wide, believed={"gyro": {"unit": "deg/s", "range": 800.0}})
    observed = observe(same)
    assert observed.timing == ()
    assert any("which the simulator has too" in note.why for note in observed.set_aside)


def test_a_drift_is_no_warm_up_where_no_slow_noise_is_believed() -> None:
    from dut_emulator.effects.thermal import WarmUp

    observed = seen(3, lambda _sent: None)
    trials = [Trial("gyro.warm_up", (WarmUp("gyro"),))]
    assert without_drifts(trials, [observed]) == []
    assert any("a drift is not told from warm-up" in one.why for one in drift_noted(observed).set_aside)
    believed = NoiseBelief(slow_deviation_si=1e-5, slow_correlation_time_s=300.0)
    outputs = {s: dataclasses.replace(one, noise=believed) for s, one in observed.outputs.items()}
    assert without_drifts(trials, [dataclasses.replace(observed, outputs=outputs)]) == trials
