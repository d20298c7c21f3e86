"""The prediction against its formula, written anew here: y = M u + b, one pole, Earth rate, pulses."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dut_emulator.recording.recorder import recorded
from gap_diagnosis.belief import triad_belief
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observing import observe
from protocol.recordings import Recording

DEG, G = math.pi / 180, 9.80665
SI = {"deg/s": DEG, "rad/s": 1.0, "g": G, "m/s^2": 1.0, "gauss": 1e-4, "uT": 1e-6}
WORDS = {"gyro": "rate", "acc": "acc", "mag": "mag"}


def acting(recording: Recording, sensor: str, t: np.ndarray) -> np.ndarray:
    """(n, 3): the stand's columns, and the Earth's rate turned by the gimbals, axis by axis."""
    stand = recording.streams["stand"]
    names = [f"{WORDS[sensor]}_{axis}" for axis in "xyz"]
    u = np.stack(
        [np.interp(t, stand.columns["t"], stand.columns[n]) * SI[stand.units[n]] for n in names], axis=1
    )
    if sensor != "gyro":
        return u
    angles = [
        np.interp(t, stand.columns["t"], stand.columns[f"angle_{name}"]) * DEG
        for name in ("outer", "middle", "inner")
    ]
    earth = np.zeros((len(t), 3))
    latitude = recording.site["latitude_deg"] * DEG
    earth[:, 1], earth[:, 2] = 7.292115e-5 * math.cos(latitude), 7.292115e-5 * math.sin(latitude)
    for (first, second), angle in zip(((0, 1), (2, 0), (1, 2)), angles, strict=True):
        one, other = earth[:, first].copy(), earth[:, second].copy()
        earth[:, first] = np.cos(angle) * one + np.sin(angle) * other
        earth[:, second] = np.cos(angle) * other - np.sin(angle) * one
    return u + earth


def model(believed: dict[str, Any], u: np.ndarray, period_s: float) -> np.ndarray:
    """Step by step: between samples the input is a straight line, the pole's answer to that is exact."""
    y = u @ np.array(believed["matrix"]).T + np.array(believed["bias"]) * SI[believed["unit"]]
    if not believed.get("bandwidth_hz"):
        return y
    tau = 1.0 / (2.0 * math.pi * believed["bandwidth_hz"])
    left = math.exp(-period_s / tau)
    state, out = y[0].copy(), [y[0].copy()]
    for before, now in pairwise(y):
        slope = (now - before) / period_s
        state = now - tau * slope + (state - before + tau * slope) * left
        out.append(state)
    return np.array(out)


@pytest.mark.parametrize(
    ("product", "profile", "values"),
    [
        ("fog", "static", {"duration_s": 10.0}),
        ("rate_gyro_triad", "static", {"duration_s": 30.0}),
        ("mems_ahrs", "rate_staircase", {"dwell_s": 0.5}),
        ("gnc_module", "static", {"duration_s": 10.0}),
    ],
)
def test_a_prediction_is_its_formula(product: str, profile: str, values: dict[str, float]) -> None:
    recording = recorded(product, profile, values=values, seed=3, serial="U-0007")
    observed = observe(recording)
    t = recording.streams["dut"].columns["t"]
    for sensor in WORDS:
        if sensor in recording.believed:
            wanted = model(recording.believed[sensor], acting(recording, sensor, t), observed.sample_period_s)
            got = observed.outputs[sensor].predicted_si  # type: ignore[index]
            assert got == pytest.approx(wanted, abs=1e-9 * max(1.0, float(np.abs(wanted).max())))


def test_counts_and_volts_come_out_in_si() -> None:
    fog = recorded("fog", "static", values={"duration_s": 5.0}, seed=3, serial="U-0007")
    shown = observe(fog).outputs["gyro"].values_si
    assert np.isnan(shown[:, :2]).all()
    assert shown[7, 2] == pytest.approx((fog.streams["dut"].columns["gyro_z"][7] - 2000) / 20000 * DEG)
    analogue = recorded("rate_gyro_triad", "static", values={"duration_s": 5.0}, seed=3, serial="U-0007")
    per_unit = analogue.believed["gyro"]["volts_per_unit"]
    volts = analogue.streams["dut"].columns["volt_y"][7]
    assert observe(analogue).outputs["gyro"].values_si[7, 1] == pytest.approx(volts / per_unit * DEG)


@pytest.mark.parametrize(("profile", "sensor"), [("multi_position", "gyro"), ("overload", "acc")])
def test_pulses_are_means_over_their_period(profile: str, sensor: str) -> None:
    """Summed up, prediction and pulses stay together: to a few pulses, and what bias and noise add."""
    recording = recorded("pulse_imu", profile, seed=3, serial="U-0007")
    observed = observe(recording)
    output = observed.outputs[sensor]  # type: ignore[index]
    believed = recording.believed[sensor]
    per_si = believed["pulses_per_unit_s"] / SI[believed["unit"]]
    difference = np.nancumsum(output.residual_si, axis=0) * observed.sample_period_s * per_si
    pulses = np.nancumsum(np.abs(output.values_si), axis=0)[-1].max() * observed.sample_period_s * per_si
    assert np.abs(difference).max() < 30.0 + 2e-3 * pulses
    assert output.quantum_si == pytest.approx(1.0 / (per_si * observed.sample_period_s))


def test_beliefs_come_in_any_accepted_unit() -> None:
    def believed(**gyro: Any) -> Recording:
        return Recording("own", {}, {}, {}, believed={"gyro": {"unit": "deg/s", **gyro}})

    for value, unit in ((0.2, "deg/sqrt(h)"), (0.2 / 60, "deg/s/sqrt(Hz)"), (0.2 / 60 * DEG, "rad/sqrt(s)")):
        noise = triad_belief(believed(angle_random_walk={"value": value, "unit": unit}), "gyro").noise
        assert noise.white_si_per_sqrt_hz == pytest.approx(0.2 / 60 * DEG)
    for extra, level, coefficient in (
        ({"correlation_time_s": 300}, 5 / 3600 * DEG, None),
        ({}, None, 5 / 3600 * DEG),
    ):
        slow = {"value": 5, "unit": "deg/h", "unit_spread": 0.4, **extra}
        noise = triad_belief(believed(bias_instability=slow), "gyro").noise
        assert noise.slow_deviation_si == (level and pytest.approx(level))
        assert noise.slow_coefficient_si == (coefficient and pytest.approx(coefficient))
        assert noise.slow_spread == 0.4
    whole = triad_belief(believed(quantum=0.005, range=400, bias=[1, 0, 0]), "gyro")
    assert (whole.quantum_si, whole.range_si, whole.bias_si[0]) == pytest.approx(
        (0.005 * DEG, 400 * DEG, DEG)
    )
    for wrong in (
        {"unit": "g"},
        {"matrix": [[1, 0], [0, 1]]},
        {"angle_random_walk": {"value": 1, "unit": "g"}},
        {"quantum": "small"},
        {"bias_instability": 5},
    ):
        with pytest.raises(DiagnosisError) as caught:
            triad_belief(believed(**wrong), "gyro")
        assert "believed.gyro" in caught.value.where
