"""Figures that recordings of a rate gyro triad must show: paper 4's, and closed forms.

K, Y_FS and the eleven points are those of paper 4; the table's accuracy of 1e-4, the fixture's milliradian
and what the format cannot say of a unit (some 1e-4 of temperature and asymmetry) are the tolerances.
"""

import numpy as np

from protocol.recordings import Recording

K_V_PER_DEG_S = 0.050698
FULL_SCALE_V = 10.1369
AXES = "xyz"


def _readings(recording: Recording, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) rates in deg/s, (n,) strokes, (n, 3) means of the three outputs over the dwells of one axis."""
    dut, points = recording.streams["dut"].columns, recording.streams["points"].columns
    rows = np.flatnonzero(points["axis"] == axis)
    means = []
    for begin_s, duration_s in zip(points["t"][rows], points["duration"][rows], strict=True):
        inside = slice(*np.searchsorted(dut["t"], [begin_s - 1e-6, begin_s + duration_s - 1e-6]))
        means.append([dut[f"volt_{name}"][inside].mean() for name in AXES])
    return points["rate"][rows], points["stroke"][rows], np.array(means)


def eleven_point(recording: Recording) -> None:
    matrix = np.array(recording.believed["gyro"]["matrix"])
    for axis in (1, 2, 3):
        rates, strokes, volts = _readings(recording, axis)
        assert sorted(set(np.round(rates, 9))) == list(range(-100, 101, 20))
        slopes = np.polyfit(rates, volts, 1)[0] / K_V_PER_DEG_S
        np.testing.assert_allclose(slopes, matrix[:, axis - 1], atol=1.5e-3)
        assert abs(slopes[axis - 1] - matrix[axis - 1, axis - 1]) < 5e-4
        own = volts[:, axis - 1]
        span = own[rates == rates.max()].mean() - own[rates == rates.min()].mean()
        assert abs(span / FULL_SCALE_V - 1) < 0.02
        inner = np.abs(rates) < 99
        loop = own[inner & (strokes == 1)].mean() - own[inner & (strokes == -1)].mean()
        assert 5e-5 < -loop / span < 1e-3, "some 0.02 % of the full scale, and the output lags"
    stand = recording.streams["stand"].columns
    turning = np.stack([stand[f"rate_{name}"] for name in AXES], axis=1)
    assert abs(np.abs(turning).max() - 100.0) < 1e-3


def static(recording: Recording) -> None:
    """At rest: the intercept, the Allan deviation N / √τ at 1 s, and 3 °C of own heat with τ = 150 s."""
    dut, gyro = recording.streams["dut"].columns, recording.believed["gyro"]
    rates = np.stack([dut[f"volt_{name}"] for name in AXES], axis=1) / K_V_PER_DEG_S
    settled = rates[dut["t"] > 80.0]
    np.testing.assert_allclose(settled.mean(axis=0), gyro["bias"], atol=0.05)
    whole = rates[: len(rates) // 50 * 50].reshape(-1, 50, 3).mean(axis=1)
    allan = np.sqrt(np.mean(np.diff(whole, axis=0) ** 2, axis=0) / 2)
    expected = gyro["angle_random_walk"]["value"]
    assert abs(np.exp(np.log(allan).mean()) / expected - 1) < 0.2
    own_heat_c = 3.0 * -np.expm1(-dut["t"] / 150.0)
    np.testing.assert_allclose(dut["temp"], 23.0 + own_heat_c, atol=0.006)
    stand = recording.streams["stand"].columns
    assert not any(stand[f"rate_{name}"].any() for name in AXES)


ORACLES = {"eleven_point": eleven_point, "static": static}
