"""What a recording of a pulse IMU has to agree with: closed forms of the motion, counted in the recording."""

from collections.abc import Callable

import numpy as np

from protocol.recordings import Recording

G_STANDARD = 9.80665
ACC_PULSES_PER_M_S = 10_000.0 / G_STANDARD
GYRO_PULSES_PER_DEG = 3600.0
UNITS_SI = {"g": G_STANDARD, "deg/s": np.pi / 180}
BIAS_M_S2, ASYMMETRY, D_DEG_S_G = 6e-3 * G_STANDARD, 5e-4, 2e-3
"""Beyond what any unit of the lot has."""


def net(recording: Recording, channel: str) -> np.ndarray:
    """(n,) positive less negative pulses of each sample period."""
    columns = recording.streams["dut"].columns
    positive, negative = columns[f"pulse_{channel}_pos"], columns[f"pulse_{channel}_neg"]
    assert positive.dtype == negative.dtype == np.int32
    assert (positive >= 0).all()
    assert (negative >= 0).all()
    assert positive[0] == negative[0] == 0
    return positive.astype(np.int64) - negative


def check_overload(recording: Recording) -> None:
    """Half-cycles of r ω² cos: 2 A₀ / ω pulses each way, to bias, asymmetry and two pulses."""
    values = recording.test["values"]
    assert values["crank"] == 0, "the closed form is a sinusoid's"
    axis = "xyz"[int(values["axis"]) - 1]
    omega = np.sqrt(values["overload_g"] * G_STANDARD / values["radius_m"])
    marks_s = recording.streams["zero_mark"].columns["t"]
    half_s = np.pi / omega
    np.testing.assert_allclose(np.diff(marks_s), half_s, atol=1e-3 * half_s)
    time_s = recording.streams["dut"].columns["t"]
    totals = np.interp(marks_s, time_s, np.cumsum(net(recording, f"acc_{axis}")))
    change = 2 * values["overload_g"] * G_STANDARD / omega
    expected = ACC_PULSES_PER_M_S * change * np.where(np.arange(len(marks_s) - 1) % 2 == 0, 1, -1)
    scale = recording.believed["acc"]["matrix"]["xyz".index(axis)]["xyz".index(axis)]
    margin = ACC_PULSES_PER_M_S * (BIAS_M_S2 * half_s + ASYMMETRY * change) + 3
    np.testing.assert_allclose(np.diff(totals), scale * expected, atol=margin)
    gyro = np.interp(marks_s, time_s, np.cumsum(net(recording, "gyro_x")))
    assert np.abs(np.diff(gyro, 2)).max() < GYRO_PULSES_PER_DEG * 4 * D_DEG_S_G * change / G_STANDARD + 2


def check_on_a_turntable(recording: Recording) -> None:
    """Sums over the run are those of the stand's reading through the believed matrix and bias.

    What the belief leaves out stays below 2 mg (how the unit sits, asymmetry, temperature), and below
    0.01 °/s (Earth rate, g-sensitivity) or 0.2 % of the way (how it sits).
    """
    stand = recording.streams["stand"]
    time_s = stand.columns["t"]
    span_s = float(recording.streams["dut"].columns["t"][-1])
    for triad, name, unit, pulses in (
        ("acc", "acc", "g", ACC_PULSES_PER_M_S * G_STANDARD),
        ("gyro", "rate", "deg/s", GYRO_PULSES_PER_DEG),
    ):
        believed = recording.believed[triad]
        assert believed["unit"] == unit
        told = stand.si(*(f"{name}_{axis}" for axis in "xyz")) / (
            G_STANDARD if triad == "acc" else np.pi / 180
        )
        way, path = np.trapezoid(told, time_s, axis=0), np.trapezoid(np.abs(told), time_s, axis=0)
        expected = np.array(believed["matrix"]) @ way + np.array(believed["bias"]) * span_s
        counted = np.array([net(recording, f"{triad}_{axis}").sum() for axis in "xyz"]) / pulses
        left_out = 2e-3 * span_s if triad == "acc" else 0.01 * span_s + 2e-3 * float(path.max())
        np.testing.assert_allclose(counted, expected, atol=left_out)


ORACLES: dict[str, Callable[[Recording], None]] = {
    "overload": check_overload,
    "static": check_on_a_turntable,
    "multi_position": check_on_a_turntable,
}
