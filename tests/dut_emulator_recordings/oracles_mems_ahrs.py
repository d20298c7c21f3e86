"""Figures that recordings of a MEMS attitude unit must show: paper 2's, and closed forms.

Copied facts: a delay of 1.5 ms and a pole at 80 Hz (2.0 ms), 13 ms between clocks without a trigger, the
calibrated range of −40 to 70 °C, the flag bits of the unit's link.
"""

import numpy as np

from protocol.recordings import Recording

DELAY_S, POLE_S = 1.5e-3, 1.0 / (2.0 * np.pi * 80.0)
CLOCK_OFFSET_S = 0.013
STEADY, ALIGNED, BEYOND_CALIBRATED, OVER_TEMPERATURE = 8, 16, 32, 64
AXES = "xyz"


def _triad(recording: Recording, stream: str, name: str) -> np.ndarray:
    columns = recording.streams[stream].columns
    return np.stack([columns[f"{name}_{axis}"] for axis in AXES], axis=1).astype(np.float64)


def _stand_at_dut(recording: Recording, name: str) -> np.ndarray:
    """(n, 3) what the stand read, at the unit's instants."""
    times, read = recording.streams["dut"].columns["t"], recording.streams["stand"].columns["t"]
    columns = _triad(recording, "stand", name).T
    return np.stack([np.interp(times, read, column) for column in columns], axis=1)


def _flag(recording: Recording, bit: int) -> np.ndarray:
    return (recording.streams["dut"].columns["flags"] & bit) > 0


def _up(recording: Recording) -> np.ndarray:
    """(n, 3) the direction up in body axes that roll and pitch (nose up) say."""
    columns = recording.streams["dut"].columns
    roll, pitch = np.radians(columns["roll"]), np.radians(columns["pitch"])
    return np.stack([np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)


def _expected(recording: Recording, sensor: str, inputs: np.ndarray) -> np.ndarray:
    believed = recording.believed[sensor]
    return inputs @ np.array(believed["matrix"]).T + np.array(believed["bias"])


def _stretches(still: np.ndarray, least: int) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]


def static(recording: Recording) -> None:
    gyro, acc = _triad(recording, "dut", "gyro"), _triad(recording, "dut", "acc")
    means = gyro[: len(gyro) // 200 * 200].reshape(-1, 200, 3).mean(axis=1)  # of 1 s
    allan = np.sqrt(np.mean(np.diff(means, axis=0) ** 2, axis=0) / 2)
    density = recording.believed["gyro"]["angle_random_walk"]["value"] / 60.0  # deg/√h → deg/√s
    assert abs(np.exp(np.log(allan).mean()) / density - 1) < 0.25
    level = np.array([0.0, 0.0, recording.site["gravity_m_s2"] / 9.80665])
    assert np.abs(acc.mean(axis=0) - _expected(recording, "acc", level)).max() < 3e-3
    columns = recording.streams["dut"].columns
    late = columns["t"] > 2.0
    assert np.abs(columns["roll"][late]).max() < 1.0
    assert np.abs(columns["pitch"][late]).max() < 1.0
    assert _flag(recording, STEADY).mean() > 0.99
    assert _flag(recording, ALIGNED)[late].all()
    warmth = columns["temp"] - 23.0
    assert abs(warmth[0]) < 0.15
    assert 2.0 < warmth[-200:].mean() < 8.0, "after 120 s most of at most 8 K"


def multi_position(recording: Recording) -> None:
    force, rate = _stand_at_dut(recording, "acc"), _stand_at_dut(recording, "rate")
    dwells = _stretches(np.abs(rate).max(axis=1) == 0, 1000)
    assert len(dwells) >= 6
    acc, up = _triad(recording, "dut", "acc"), _up(recording)
    seen: set[tuple[int, int]] = set()
    for dwell in dwells:
        inner = slice(dwell.start + 100, dwell.stop - 100)
        given = force[inner].mean(axis=0)
        assert np.abs(acc[inner].mean(axis=0) - _expected(recording, "acc", given)).max() < 5e-3
        cosine = up[inner] @ given / np.linalg.norm(given)
        assert np.degrees(np.arccos(np.minimum(cosine, 1.0))).max() < 2.5, "0.6 % of 180° at most"
        axis = int(np.abs(given).argmax())
        seen.add((axis, int(np.sign(given[axis]))))
    assert len(seen) == 6, "each axis up and down"


def rotation(recording: Recording) -> None:
    """Paper 1, Eq. 3, corrected: (Ñ⁺ − Ñ⁻) over twice the angle is a column of the forward matrix."""
    rate, gyro = _stand_at_dut(recording, "rate"), _triad(recording, "dut", "gyro")
    matrix = np.array(recording.believed["gyro"]["matrix"])
    for axis in range(3):
        others = np.delete(np.abs(rate), axis, axis=1).max(axis=1)
        turning = (others < 1e-3) & (np.abs(rate[:, axis]) > 95.0)  # positioning is no faster than 90 deg/s
        sums = [
            (gyro[part].sum(axis=0), rate[part, axis].sum())
            for part in (turning & (rate[:, axis] > 0), turning & (rate[:, axis] < 0))
        ]
        assert abs(sums[0][1] / 200.0 - 1080.0) < 60.0, "all but the slow ends of the ramps"
        column = (sums[0][0] - sums[1][0]) / (sums[0][1] - sums[1][1])
        np.testing.assert_allclose(column, matrix[:, axis], atol=1.5e-3)


def tumble(recording: Recording) -> None:
    """Forces of 1 g all round: the matrix of the accelerometers, and a gyro's few mdeg/s for each g."""
    force, rate = _stand_at_dut(recording, "acc"), _stand_at_dut(recording, "rate")
    moving = np.abs(rate).max(axis=1) > 1.0
    design = np.column_stack([force, np.ones(len(force))])[moving]
    acc = np.linalg.lstsq(design, _triad(recording, "dut", "acc")[moving], rcond=None)[0]
    np.testing.assert_allclose(acc[:3].T, np.array(recording.believed["acc"]["matrix"]), atol=3e-3)
    np.testing.assert_allclose(acc[3], recording.believed["acc"]["bias"], atol=3e-3)
    rest = _triad(recording, "dut", "gyro") - _expected(recording, "gyro", rate)
    per_g = np.linalg.lstsq(design, rest[moving], rcond=None)[0][:3]
    assert 1e-3 < np.abs(per_g).max() < 0.025, "deg/s for each g"


def rate_staircase(recording: Recording) -> None:
    rate, gyro = _stand_at_dut(recording, "rate"), _triad(recording, "dut", "gyro")
    matrix = np.array(recording.believed["gyro"]["matrix"])
    for axis in range(3):
        others = np.delete(np.abs(rate), axis, axis=1).max(axis=1)
        level = np.round(rate[:, axis], 3)
        steady = (others < 1e-6) & (np.abs(level - np.roll(level, 20)) < 1e-6)
        steady &= np.abs(level - np.roll(level, -20)) < 1e-6
        assert np.abs(level[steady]).max() > 299.9
        design = np.stack([level[steady], np.ones(steady.sum())], axis=1)
        slopes = np.linalg.lstsq(design, gyro[steady], rcond=None)[0][0]
        np.testing.assert_allclose(slopes, matrix[:, axis], atol=1.5e-3)


def swing(recording: Recording) -> None:
    """Paper 2, 4.1: ±80° at 200 °/s; 13 ms of clock make 2.6° where the angle is 0."""
    dut, stand = recording.streams["dut"].columns, recording.streams["stand"].columns
    angle, rate = np.unwrap(np.radians(stand["angle_inner"])), stand["rate_x"]
    angle = np.degrees(angle)
    moving = np.abs(np.interp(dut["t"], stand["t"], rate)) > 0.1
    inside = moving & (dut["t"] < dut["t"][-1] - 0.1)
    at = np.interp(dut["t"], stand["t"], angle)[inside]
    turning = np.interp(dut["t"], stand["t"], rate)[inside]
    roll = dut["roll"][inside]
    assert abs(np.abs(at).max() - 80.0) < 0.1
    assert abs(np.abs(turning).max() - 200.0) < 0.5
    design = np.stack([at, turning, np.ones_like(at)], axis=1)
    gain, minus_lag_s, _ = np.linalg.lstsq(design, roll, rcond=None)[0]
    assert abs(gain - recording.believed["gyro"]["matrix"][0][0]) < 3e-3
    assert abs(-minus_lag_s - (DELAY_S + POLE_S)) < 4e-4
    later = np.interp(dut["t"] + CLOCK_OFFSET_S, stand["t"], angle)[inside]
    apparent = np.abs(later - at)
    assert abs(apparent.max() - 2.6) < 0.05
    assert np.abs(at[apparent > 0.99 * apparent.max()]).max() < 15.0, "largest where the angle is 0"
    error = np.abs(roll - later)
    assert 2.6 < error.max() < 5.0
    assert np.abs(roll - at).max() < error.max() - 1.3, "most of it is the clock's"
    assert _flag(recording, STEADY)[inside][400:].mean() < 0.02, "the gates stay closed while it swings"


def sweep(recording: Recording) -> None:
    """Gain and phase of the gyro about x between 3 and 12 Hz: a pole at 80 Hz behind 1.5 ms."""
    rate, gyro = _stand_at_dut(recording, "rate")[:, 0], _triad(recording, "dut", "gyro")[:, 0]
    moving = np.flatnonzero(np.abs(rate) > 1.0)
    part = slice(moving[0], moving[0] + 12_000)
    window = np.hanning(12_000)
    given, seen = (np.fft.rfft((values[part] - values[part].mean()) * window) for values in (rate, gyro))
    frequency = np.fft.rfftfreq(12_000, 1.0 / 200.0)
    for low, high in ((1.0, 2.0), (3.0, 6.0), (6.0, 12.0)):
        band = (frequency > low) & (frequency < high)
        expected = np.exp(-2j * np.pi * frequency[band] * DELAY_S) / (
            1.0 + 2j * np.pi * frequency[band] * POLE_S
        )
        found = np.vdot(given[band] * expected, seen[band]) / np.vdot(
            given[band] * expected, given[band] * expected
        )
        assert abs(abs(found) - recording.believed["gyro"]["matrix"][0][0]) < 0.01
        assert abs(np.angle(found)) < 2.0 * np.pi * high * 4e-4


def temperature_ramp(recording: Recording) -> None:
    dut, stand = recording.streams["dut"].columns, recording.streams["stand"].columns
    air = np.interp(dut["t"], stand["t"], stand["temp"])
    sensor = dut["temp_gyro"]
    hot = np.flatnonzero(air > 69.9)[-1]
    assert 3.0 < sensor[hot] - air[hot] <= 8.0, "own heat, with paste"
    assert _flag(recording, BEYOND_CALIBRATED)[sensor > 70.3].all()
    assert not _flag(recording, BEYOND_CALIBRATED)[(sensor < 69.7) & (sensor > -39.7)].any()
    assert not _flag(recording, OVER_TEMPERATURE).any()
    slope = np.gradient(air[::100], dut["t"][::100])
    at_20 = [np.abs(air[::100] - 20.0) < 0.3] * 2
    up, down = (
        sensor[::100][near & (sign * slope > 0.02)] for near, sign in zip(at_20, (1, -1), strict=True)
    )
    ramp_c_s = np.abs(slope[at_20[0]]).max()
    lag_s = (down.mean() - up.mean()) / (2.0 * ramp_c_s)
    assert 40.0 < lag_s < 250.0, "minutes, as for 95 g"
    outputs = np.concatenate(
        [_triad(recording, "dut", "gyro") / 0.07, _triad(recording, "dut", "acc") / 1.2e-3], 1
    )
    means = outputs[: len(outputs) // 1000 * 1000].reshape(-1, 1000, 6).mean(axis=1)  # 10 s; white noise is 1
    at_c = sensor[: len(outputs) // 1000 * 1000].reshape(-1, 1000).mean(axis=1)
    rest = [
        means - np.stack([np.polyval(fit, at_c) for fit in np.polyfit(at_c, means, n).T], 1) for n in (1, 4)
    ]
    bent, smooth = (np.sqrt((part**2).mean(axis=0)) for part in rest)
    assert (bent > 1.5 * smooth).sum() >= 2, "strongly non-linear in temperature"


def thermal_positions(recording: Recording) -> None:
    dut = recording.streams["dut"].columns
    force, rate = _stand_at_dut(recording, "acc"), _stand_at_dut(recording, "rate")
    acc = _triad(recording, "dut", "acc")
    dwells = [d for d in _stretches(np.abs(rate).max(axis=1) == 0, 800) if d.stop - d.start < 1500]
    assert len(dwells) >= 12
    believed = recording.believed["acc"]
    scales: list[float] = []
    for axis in (1, 2):
        for sign_up in dwells:
            if force[sign_up, axis].mean() < 0.99:
                continue
            near = [d for d in dwells if force[d, axis].mean() < -0.99]
            opposite = min(near, key=lambda d: abs(d.start - sign_up.start))
            middle = [slice(d.start + 100, d.stop - 100) for d in (sign_up, opposite)]
            outputs = [acc[part, axis].mean() for part in middle]
            inputs = [force[part, axis].mean() for part in middle]
            scale = (outputs[0] - outputs[1]) / (inputs[0] - inputs[1])
            excess_c = abs(float(dut["temp_acc"][middle[0]].mean()) - 25.0)
            assert abs(scale - believed["matrix"][axis][axis]) < 1e-3 + 500e-6 * excess_c
            offset = (outputs[0] + outputs[1]) / 2 - believed["bias"][axis]
            assert abs(offset) < 2e-3 + 1e-3 * excess_c
            scales.append(scale)
    assert np.ptp(scales) > 1e-3, "the scale factor follows the temperature"


def vehicle_run(recording: Recording) -> None:
    """On the road curves and braking mislead a level; with gates it stays within the paper's 1σ in flight."""
    dut, stand = recording.streams["dut"].columns, recording.streams["stand"].columns
    late = dut["t"] > 3.0
    for name, limit in (("roll", 2.3), ("pitch", 2.5)):
        error = (dut[name] - np.interp(dut["t"], stand["t"], stand[name]))[late]
        assert error.std() < limit
    force = np.linalg.norm(_stand_at_dut(recording, "acc"), axis=1)
    turning = np.abs(_stand_at_dut(recording, "rate")[:, 2]) > 5.0
    assert turning.any()
    assert _flag(recording, STEADY)[turning].mean() < 0.05
    assert force.max() > 1.02
    heading = np.unwrap(np.radians(np.interp(dut["t"], stand["t"], np.unwrap(stand["yaw"], period=360.0))))
    own = np.unwrap(np.radians(dut["yaw"]))
    drift = np.degrees((own - own[0]) - (heading - heading[0]))
    assert np.abs(drift).max() < 0.03 * np.degrees(np.ptp(heading)) + 0.05 * dut["t"][-1]


def flight(recording: Recording) -> None:
    """Paper 2, 4.2: 1σ of 2.3° in roll and 2.5° in pitch, 1° in steady flight."""
    dut, stand = recording.streams["dut"].columns, recording.streams["stand"].columns
    aligned = dut["t"] > 3.0
    error = {
        name: (dut[name] - np.interp(dut["t"], stand["t"], stand[name]))[aligned]
        for name in ("roll", "pitch")
    }
    assert error["roll"].std() < 2.3
    assert error["pitch"].std() < 2.5
    force, rate = _stand_at_dut(recording, "acc")[aligned], _stand_at_dut(recording, "rate")[aligned]
    kernel = np.ones(500) / 500  # 5 s
    norm = np.convolve(np.linalg.norm(force, axis=1), kernel, "same")
    turning = np.convolve(np.linalg.norm(rate, axis=1), kernel, "same")
    quiet = _stretches((np.abs(norm - 1.0) < 0.03) & (turning < 1.0), 3000)
    assert quiet
    settled = [slice(part.start + 2000, part.stop) for part in quiet]
    for name in ("roll", "pitch"):
        spread = np.concatenate([error[name][part] for part in settled])
        assert np.sqrt(np.mean(spread**2)) < 1.0, name
    banked = np.abs(np.interp(dut["t"], stand["t"], stand["roll"])) > 25.0
    assert _flag(recording, STEADY)[banked].mean() < 0.1, "a coordinated turn corrects nothing"


ORACLES = {
    "static": static,
    "multi_position": multi_position,
    "rotation": rotation,
    "rate_staircase": rate_staircase,
    "tumble": tumble,
    "swing": swing,
    "sweep": sweep,
    "temperature_ramp": temperature_ramp,
    "thermal_positions": thermal_positions,
    "vehicle_run": vehicle_run,
    "flight": flight,
}
