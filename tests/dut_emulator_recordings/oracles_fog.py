"""What a FOG's recordings must show, in counts: 20,000 a °/s, 2000 at rest (`protocol/fog.py`).

`UNIT` holds the effects of unit U-0001 of lot 1, as its twin file has them; everything else is closed form.
"""

import math
from collections.abc import Callable

import numpy as np

from protocol.recordings import Recording

COUNTS = 20_000.0
DEG_H = COUNTS / 3600  # counts of a degree an hour
FRAME_S = 500e-6
STAMP_S = 3556.21e-6 / 32_767  # paper 3, eq. (23)

UNIT = {
    "lag_s": 242.1105e-6,
    "pole_s": 51.365e-6,
    "bias_deg_h": 6.4214,
    "scale_factor_error": 4.07e-6,
    "scale_factor_per_c": 35.84e-6,
    "asymmetry": 11.22e-6,
    "bias_deg_h_per_c": 5.544e-3,
    "bias_deg_h_per_c2": -2.291e-4,
    "shupe_deg_h_per_c_min": 0.65302,
    "angle_random_walk_deg_sqrt_s": 2.35993e-4,
}
BIAS_INSTABILITY_DEG_H = 0.182
MOUNTING_RAD = 3e-3
"""How far the input axis may lean: the unit's own misalignment and the stand's errors together."""


def _gyro(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (s), output beyond 2000 (counts), temperature (°C)."""
    assert (recording.unit["serial"], recording.unit["product"]) == ("U-0001", "fog")
    dut = recording.streams["dut"]
    assert dut.units["gyro_z"] == "1"
    assert dut.columns["gyro_z"].dtype == np.int32
    numbers = dut.columns["counter"].astype(int)
    assert (np.diff(numbers) % 256 == 1).all()
    return dut.time_s(), dut.columns["gyro_z"] - 2000.0, dut.columns["temp"]


def _earth_up_counts(recording: Recording) -> float:
    return 15.041067 * DEG_H * math.sin(math.radians(recording.site["latitude_deg"]))


def _noise_counts(rate_hz: float) -> float:
    """σ of a sample: 200 counts at 2 kHz for the median unit."""
    sigma = UNIT["angle_random_walk_deg_sqrt_s"] * math.sqrt(rate_hz) * COUNTS
    assert abs(sigma / (200 * math.sqrt(rate_hz / 2000)) - 1) < 0.16
    return sigma


def impact(recording: Recording) -> None:
    """Bounds of the lag from 31 random impacts (corrected eqs. (16) to (18)), rest, and the jumps."""
    time_s, output, _ = _gyro(recording)
    stamps = recording.streams["dut"].columns["stamp"].astype(int)
    triggers_s = recording.streams["trigger"].time_s()
    assert len(triggers_s) == 31
    delays_s = []
    for trigger_s in triggers_s.tolist():
        after = int(np.searchsorted(time_s, trigger_s))
        rest = output[after - 180 : after]
        first = after + int(np.argmax(np.abs(output[after : after + 20] - rest.mean()) > 5 * rest.std()))
        assert stamps[first] >> 15 == 1
        stamped_s = (stamps[first] & 0x7FFF) * STAMP_S
        assert 0 <= time_s[first] - trigger_s - stamped_s < STAMP_S * 1.001
        delays_s.append(stamped_s)
        # friction: 1 - 1/e of what is left beyond the dry part after tau; 40 deg/s with 3 % of scatter
        peak = float(np.max(output[first : first + 40]))
        assert 0.85 * 40 * COUNTS < peak < 1.3 * 40 * COUNTS
        assert rest.mean() > -1000
        assert abs(rest.std() / _noise_counts(2000) - 1) < 0.3
    upper_s, lower_s = min(delays_s) + STAMP_S, max(delays_s) - FRAME_S
    assert lower_s <= UNIT["lag_s"] + 0.1e-6  # the pole hides the first 0.06 µs of a rise
    assert UNIT["lag_s"] <= upper_s + 0.1e-6  # latency of the trigger
    assert 0 < upper_s - lower_s < FRAME_S * 11 / 30  # P(larger range of 31 uniform phases) = 2e-5
    assert (stamps[time_s < triggers_s[0]] == 0).all()
    assert stamps[np.searchsorted(time_s, triggers_s[0] + 3.6e-3)] == 0xFFFF


def static(recording: Recording) -> None:
    """Mean: Earth rate and bias; noise: 100 counts at 500 Hz, N / √τ at 1 s."""
    _, output, temperature_c = _gyro(recording)
    expected = _earth_up_counts(recording) + DEG_H * (
        UNIT["bias_deg_h"] + UNIT["bias_deg_h_per_c"] * (temperature_c.mean() - 25)
    )
    slow = 3 * BIAS_INSTABILITY_DEG_H * DEG_H
    assert abs(output.mean() - expected) < slow + 5 * _noise_counts(500) / math.sqrt(len(output))
    assert abs(output.std() / _noise_counts(500) - 1) < 5 / math.sqrt(2 * len(output))
    seconds = output[: len(output) // 500 * 500].reshape(-1, 500).mean(axis=1)
    allan = math.sqrt(np.mean(np.diff(seconds) ** 2) / 2)
    assert abs(allan / (UNIT["angle_random_walk_deg_sqrt_s"] * COUNTS) - 1) < 5 / math.sqrt(len(seconds))


def rate_staircase(recording: Recording) -> None:
    """Scale factor and its asymmetry from the levels of body z; x and y are hardly seen."""
    time_s, output, temperature_c = _gyro(recording)
    stand = recording.streams["stand"]
    rates = np.stack(
        [np.interp(time_s, stand.time_s(), stand.columns[f"rate_{axis}"]) for axis in "xyz"], axis=1
    )
    steady = np.abs(rates[100:] - rates[:-100]).max(axis=1) < 1e-3
    steady = np.convolve(np.pad(~steady, (50, 50), constant_values=True), np.ones(101), "same") == 0
    upright = time_s > time_s[np.abs(rates[:, :2]).max(axis=1) > 1].max() + 1  # body z is turned last
    earth = _earth_up_counts(recording)
    z = rates[steady & upright, 2]
    warmth = UNIT["scale_factor_per_c"] * (temperature_c[steady & upright] - 25) * z
    design = np.stack([np.ones_like(z), z, np.abs(z)], axis=1)
    fitted = np.linalg.lstsq(design, output[steady & upright] - earth - COUNTS * warmth, rcond=None)[0]
    assert np.ptp(z) > 590
    assert abs(fitted[0] - UNIT["bias_deg_h"] * DEG_H) < 3 * BIAS_INSTABILITY_DEG_H * DEG_H
    assert abs(fitted[1] / COUNTS - 1 - UNIT["scale_factor_error"]) < 5e-5  # the stand's own scale factor
    assert abs(fitted[2] / COUNTS - UNIT["asymmetry"]) < 1.5e-6
    lying = np.stack([np.ones_like(time_s), rates[:, 0], rates[:, 1]], axis=1)[steady & ~upright]
    leans = np.linalg.lstsq(lying, output[steady & ~upright], rcond=None)[0][1:] / COUNTS
    assert np.ptp(lying[:, 1:], axis=0).min() > 590
    assert np.abs(leans).max() < MOUNTING_RAD


def sweep(recording: Recording) -> None:
    """Delay behind the stand: the pure lag and the pole's time constant."""
    time_s, output, _ = _gyro(recording)
    stand = recording.streams["stand"]
    stand_s, rate = stand.time_s(), stand.columns["rate_z"].astype(float)
    acceleration = np.gradient(rate, stand_s)
    inside = slice(1, -1)
    at_stand = output[np.searchsorted(time_s, stand_s[inside] - 1e-9)]
    design = np.stack([np.ones(len(at_stand)), rate[inside], acceleration[inside]], axis=1)
    _, scale, minus_delay = np.linalg.lstsq(design, at_stand, rcond=None)[0]
    assert abs(scale / COUNTS - 1) < 2e-3
    assert abs(-minus_delay / scale - UNIT["lag_s"] - UNIT["pole_s"]) < 12e-6


def temperature_ramp(recording: Recording) -> None:
    """Bias over temperature and over its rate (Shupe), with the coil's own temperature as input."""
    time_s, output, temperature_c = _gyro(recording)
    assert temperature_c.min() < -30
    assert temperature_c.max() > 65
    minutes = [
        signal[: len(signal) // 1200 * 1200].reshape(-1, 1200).mean(axis=1)
        for signal in (time_s, output, temperature_c)
    ]
    rate_c_min = np.gradient(minutes[2], minutes[0]) * 60
    assert np.ptp(rate_c_min) > 3
    warm = minutes[2] - 25
    design = np.stack([np.ones_like(warm), warm, warm**2, rate_c_min], axis=1)
    _, per_c, per_c2, shupe = np.linalg.lstsq(design, minutes[1], rcond=None)[0] / DEG_H
    # the slow noise of 0.2 °/h hardly hides either over two hours
    assert abs(per_c - UNIT["bias_deg_h_per_c"]) < 4e-3
    assert abs(per_c2 - UNIT["bias_deg_h_per_c2"]) < 1e-4
    assert abs(shupe - UNIT["shupe_deg_h_per_c_min"]) < 0.1


ORACLES: dict[str, Callable[[Recording], None]] = {
    "impact": impact,
    "static": static,
    "rate_staircase": rate_staircase,
    "sweep": sweep,
    "temperature_ramp": temperature_ramp,
}
