"""What is known beforehand of every recording of a GNC module, from closed forms and the product's sheet.

Inertial outputs are turned into inputs by the matrix and bias that the recording believes, u = M⁻¹ (y − b),
with nothing of the emulator: what is left is noise, turn-on biases and the stand's errors.
"""

import math
from collections.abc import Callable

import numpy as np

from protocol.recordings import Recording

EARTH_RATE_DEG_H = 15.0411
G_M_S2 = 9.80665
LATENCY_S = (0.02, 0.2)
"""Of receivers: least and greatest."""
GYRO_LSB_DEG_S, ACC_LSB_G, GYRO_RANGE_DEG_S = 0.0025, 0.0005, 400.0
GYRO_SATURATED = 2


def value(recording: Recording, name: str) -> float:
    return float(recording.test["values"][name])


def inputs(recording: Recording, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """(n,) time, (n, 3) input in the recording's unit."""
    stream, known = recording.stream("dut"), recording.believed[sensor]
    seen = np.stack([stream.columns[f"{sensor}_{axis}"] for axis in "xyz"], axis=1)
    return stream.columns["t"], np.linalg.solve(known["matrix"], (seen - known["bias"]).T).T


def of_stand(recording: Recording, name: str, times: np.ndarray) -> np.ndarray:
    stream = recording.stream("stand")
    columns = [stream.columns[f"{name}_{axis}"] for axis in "xyz"]
    return np.stack([np.interp(times, stream.columns["t"], column) for column in columns], axis=1)


def white_noise_of_a_sample(recording: Recording, sensor: str, quantum: float) -> float:
    """Deviation at 200 Hz in °/s or g."""
    word = {"gyro": "angle_random_walk", "acc": "velocity_random_walk"}[sensor]
    per_hour = recording.believed[sensor][word]["value"]
    white = per_hour / 60 * math.sqrt(200.0) / {"gyro": 1.0, "acc": G_M_S2}[sensor]
    return math.hypot(white, quantum / math.sqrt(12))


def check_against_stand(recording: Recording, gyro_deg_s: float, acc_g: float) -> None:
    """One-second means of rate and force are the stand's, Earth rate apart."""
    times, rate = inputs(recording, "gyro")
    _, force = inputs(recording, "acc")
    blocks = len(times) // 200
    for seen, name, bound in ((rate, "rate", gyro_deg_s), (force, "acc", acc_g)):
        difference = (seen - of_stand(recording, name, times))[: blocks * 200]
        means = difference.reshape(blocks, 200, 3).mean(axis=1)
        assert np.abs(means).max() < bound, (name, np.abs(means).max(axis=0))


def static(recording: Recording) -> None:
    stream = recording.stream("dut")
    times, rate = inputs(recording, "gyro")
    _, force = inputs(recording, "acc")
    assert abs(len(times) - value(recording, "duration_s") * 200) <= 1
    assert (np.diff(stream.columns["counter"].astype(int)) == 1).all()
    for name, quantum in (("gyro_x", GYRO_LSB_DEG_S), ("acc_z", ACC_LSB_G)):
        counts = stream.columns[name] / quantum
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    latitude, gravity = math.radians(recording.site["latitude_deg"]), recording.site["gravity_m_s2"]
    expected = EARTH_RATE_DEG_H * np.array([0.0, math.cos(latitude), math.sin(latitude)])  # heading 0
    assert np.abs(rate.mean(axis=0) * 3600 - expected).max() < 40.0  # turn-on, slow noise, warmth
    assert abs(force[:, 2].mean() - gravity / G_M_S2) < 1e-3
    assert np.abs(force[:, :2].mean(axis=0)).max() < 5e-3
    for seen, sensor, quantum in ((rate, "gyro", GYRO_LSB_DEG_S), (force, "acc", ACC_LSB_G)):
        deviation = np.diff(seen, axis=0).std() / math.sqrt(2)
        assert 0.9 < deviation / white_noise_of_a_sample(recording, sensor, quantum) < 1.1, sensor


def multi_position(recording: Recording) -> None:
    _, force = inputs(recording, "acc")
    times, rate = inputs(recording, "gyro")
    gravity = recording.site["gravity_m_s2"] / G_M_S2
    still = np.abs(of_stand(recording, "rate", times)).max(axis=1) < 1e-3
    starts = np.flatnonzero(np.diff(still.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(still.astype(int), append=0) == -1)
    long = [
        (a, b) for a, b in zip(starts, ends, strict=True) if b - a > 0.9 * 200 * value(recording, "dwell_s")
    ]
    assert len(long) == value(recording, "positions")
    means = np.array([force[a + 50 : b - 50].mean(axis=0) for a, b in long])
    np.testing.assert_allclose(np.linalg.norm(means, axis=1), gravity, atol=1e-3)
    assert np.abs(means.sum(axis=0)).max() < 0.02  # each direction with its opposite
    assert np.abs(rate[still].mean(axis=0)).max() < 0.02


def rotation(recording: Recording) -> None:
    times, rate = inputs(recording, "gyro")
    wanted = value(recording, "angle_deg")
    turned = np.cumsum(rate, axis=0) * float(np.diff(times).mean())
    np.testing.assert_allclose(np.ptp(turned, axis=0), wanted, atol=1.5)
    assert np.abs(turned[-1]).max() < 2.0  # forth and back
    peak = wanted / (value(recording, "duration_s") - value(recording, "ramp_s"))
    assert abs(np.percentile(np.abs(rate[:, 0]), 99.9) / peak - 1) < 0.02


def rate_staircase(recording: Recording) -> None:
    _, rate = inputs(recording, "gyro")
    highest, steps = value(recording, "max_rate_deg_s"), round(value(recording, "steps"))
    for axis in range(3):
        for level in np.arange(-steps, steps + 1) / steps * highest:
            at_level = rate[np.abs(rate[:, axis] - level) < 3.0, axis]
            assert len(at_level) >= 0.9 * 200 * value(recording, "dwell_s"), (axis, level)
            assert abs(np.median(at_level) - level) < 0.05 + 4e-4 * abs(level), (axis, level)


def tumble(recording: Recording) -> None:
    _, force = inputs(recording, "acc")
    _, rate = inputs(recording, "gyro")
    gravity = recording.site["gravity_m_s2"] / G_M_S2
    smooth = np.stack([np.convolve(force[:, k], np.ones(20) / 20, "valid") for k in range(3)], axis=1)
    assert np.abs(np.linalg.norm(smooth, axis=1) - gravity).max() < 5e-3
    reached = np.ptp(smooth, axis=0)
    assert (np.sort(reached)[-2:] > 1.99 * gravity).all()  # two axes see all of +g to −g
    turning = np.linalg.norm(rate, axis=1)
    assert abs(np.median(turning[turning > 6.0]) - value(recording, "rate_deg_s")) < 0.3


def swing(recording: Recording) -> None:
    times, rate = inputs(recording, "gyro")
    amplitude, peak = value(recording, "amplitude_deg"), value(recording, "peak_rate_deg_s")
    frequency_hz = peak / (2 * math.pi * amplitude)  # of A sin 2πft
    middle = slice(len(times) // 3, 2 * len(times) // 3)
    phase = 2 * math.pi * frequency_hz * times[middle]
    design = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
    found, *_ = np.linalg.lstsq(design, rate[middle, 0], rcond=None)
    assert abs(math.hypot(found[0], found[1]) / peak - 1) < 2e-3
    assert abs(found[2]) < 0.05
    left = (rate[middle, 0] - design @ found).std()
    assert left < 2.0 * white_noise_of_a_sample(recording, "gyro", GYRO_LSB_DEG_S)


def sweep(recording: Recording) -> None:
    times, rate = inputs(recording, "gyro")
    peak, limit = value(recording, "peak_rate_deg_s"), value(recording, "peak_acceleration_deg_s2")
    slowest = 2 * math.pi * value(recording, "low_hz")
    low = peak / math.hypot(1.0, slowest * peak / limit)  # between the limits of rate and of acceleration
    smooth = np.stack([np.convolve(rate[:, k], np.ones(10) / 10, "valid") for k in range(3)], axis=1)
    reached = np.abs(smooth).max(axis=0)
    assert (reached > 0.7 * low).all()  # the sweep opens over its first period
    assert (reached < 1.02 * low).all(), reached / low
    noise = white_noise_of_a_sample(recording, "gyro", GYRO_LSB_DEG_S)
    left, drift = np.zeros(3), 0.0
    for _ in range(
        2
    ):  # the unit's crystal makes it early or late as time goes on: to first order, then exactly
        turning = of_stand(recording, "rate", times * (1 - drift))
        slope = np.gradient(turning, times, axis=0)
        drifts = []
        for axis in range(3):
            columns = (slope[:, axis], times * slope[:, axis], turning[:, axis], np.ones_like(times))
            design, difference = np.stack(columns, axis=1), rate[:, axis] - turning[:, axis]
            found, *_ = np.linalg.lstsq(design, difference, rcond=None)
            left[axis] = (difference - design @ found).std()
            drifts.append(-found[1])
            assert abs(found[2]) < 1e-3
        drift += float(np.mean(drifts))
    assert abs(drift) < 60e-6
    assert abs(math.sqrt(np.mean(left**2)) / noise - 1) < 0.1  # no filter besides


def spin(recording: Recording) -> None:
    stream, known = recording.stream("dut"), recording.believed["mag"]
    fastest = value(recording, "max_rate_rev_s")
    seen = np.stack([stream.columns[f"mag_{axis}"] for axis in "xyz"], axis=1)
    stand_rate = of_stand(recording, "rate", stream.columns["t"])
    axis = int(np.argmax(np.abs(stand_rate).max(axis=0)))
    at_speed = np.abs(np.abs(stand_rate[:, axis]) / 360 - fastest) < 1e-3 * fastest
    assert at_speed.sum() > 0.9 * 200 * value(recording, "dwell_s")
    if fastest * 360 > GYRO_RANGE_DEG_S:
        gyro = stream.columns[f"gyro_{'xyz'[axis]}"][at_speed]
        np.testing.assert_allclose(np.abs(gyro), GYRO_RANGE_DEG_S, atol=1e-9)
        assert (stream.columns["status"][at_speed] & GYRO_SATURATED).all()
    across = [k for k in range(3) if k != axis]
    spun = seen[at_speed][:, across]
    # centre of an ellipse by least squares: A x² + B xy + C y² + D x + E y = 1
    x, y = (spun - spun.mean(axis=0)).T
    a, b, c, d, e = np.linalg.lstsq(
        np.stack([x * x, x * y, y * y, x, y], axis=1), np.ones_like(x), rcond=None
    )[0]
    centre = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e]) + spun.mean(axis=0)
    matrix, field = np.array(known["matrix"]), np.array(recording.site["field_uT"])
    along = seen[at_speed, axis].mean() - known["bias"][axis]
    couplings = matrix[across, axis] / matrix[axis, axis] * along
    np.testing.assert_allclose(centre, np.array(known["bias"])[across] + couplings, atol=5e-3)
    assert abs(math.hypot(*(field / 100)) - 0.525) < 0.1
    assert 0.0 < math.hypot(*np.ptp(spun, axis=0)) / 2 < 1.1 * math.sqrt(2) * math.hypot(*(field / 100))


def fixes(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) time, (n, 3) position and velocity of the epochs with a three-dimensional fix."""
    stream = recording.stream("gnss")
    fixed = stream.columns["fix_type"] == 3
    columns = [
        np.stack([stream.columns[f"{name}_{axis}"] for axis in ("east", "north", "up")], axis=1)[fixed]
        for name in ("position", "velocity")
    ]
    return stream.columns["t"][fixed], columns[0], columns[1]


def check_latency(seen: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> float:
    """The latency L of seen = p(t) − L v(t) + constant, by least squares; the rest has to be small."""
    design = np.zeros((seen.size, 4))
    design[:, 0] = velocity.ravel()
    design[:, 1:] = np.tile(np.eye(3), (len(seen), 1))
    found, *_ = np.linalg.lstsq(design, (seen - position).ravel(), rcond=None)
    assert LATENCY_S[0] < -found[0] < LATENCY_S[1]
    assert np.abs(found[1:]).max() < 8.0
    left = (seen - position).ravel() - design @ found
    assert left.std() < 1.5
    return -float(found[0])


def satellite_static(recording: Recording) -> None:
    stream = recording.stream("gnss")
    times, position, velocity = fixes(recording)
    assert 18.5 <= times[0] <= 39.1  # subframes 1 to 3 of a 30 s frame after a search of up to 3 s
    before = stream.columns["t"] < times[0]
    assert np.isnan(stream.columns["position_east"][before & (stream.columns["fix_type"] == 0)]).all()
    assert stream.columns["satellites_used"][-1] == value(recording, "satellites")
    assert np.abs(position.mean(axis=0)).max() < 10.0
    assert np.abs(velocity.mean(axis=0)).max() < 0.02
    late = position[times > times[0] + 20]
    stated = [stream.columns[f"position_deviation_{axis}"][-1] for axis in ("east", "north", "up")]
    np.testing.assert_allclose(np.diff(late, axis=0).std(axis=0) / math.sqrt(2), stated, rtol=0.12)
    pulse = stream.columns["pulse_error"]
    assert np.nanmax(np.abs(pulse)) < 0.1  # µs
    assert 1e-3 < np.nanstd(pulse) < 4e-3
    check_against_stand_gravity(recording)


def check_against_stand_gravity(recording: Recording) -> None:
    """The unit itself rests on the bench."""
    _, force = inputs(recording, "acc")
    assert abs(force[:, 2].mean() - recording.site["gravity_m_s2"] / G_M_S2) < 1e-3


def satellite_trajectory(recording: Recording) -> None:
    times, seen, seen_velocity = fixes(recording)
    speed, radius = value(recording, "speed_m_s"), value(recording, "radius_m")
    acceleration, rest = value(recording, "acceleration_m_s2"), value(recording, "rest_s")
    ramp = speed / acceleration

    def truth(t: float) -> tuple[float, float, float, float]:
        if t < rest:
            return 0.0, 0.0, 0.0, 0.0
        if t < rest + ramp:
            return 0.0, acceleration * (t - rest) ** 2 / 2, 0.0, acceleration * (t - rest)
        straight = speed**2 / (2 * acceleration) + speed * (t - rest - ramp)
        if t < rest + ramp + value(recording, "straight_s"):
            return 0.0, straight, 0.0, speed
        corner = speed**2 / (2 * acceleration) + speed * value(recording, "straight_s")
        angle = speed * (t - rest - ramp - value(recording, "straight_s")) / radius
        return (
            radius - radius * math.cos(angle),
            corner + radius * math.sin(angle),
            speed * math.sin(angle),
            speed * math.cos(angle),
        )

    known = np.array([truth(t) for t in times])
    flat = np.zeros((len(times), 1))
    position, velocity = np.hstack([known[:, :2], flat]), np.hstack([known[:, 2:], flat])
    latency = check_latency(seen, position, velocity)
    late = np.array([truth(t - latency) for t in times])[:, 2:]
    assert (seen_velocity[:, :2] - late).std() < 0.1  # paper 1, Table 3
    check_against_stand_gravity(recording)


def vehicle_run(recording: Recording) -> None:
    times, seen, _ = fixes(recording)
    stand = recording.stream("stand").columns
    columns = [
        np.stack(
            [np.interp(times, stand["t"], stand[f"{name}_{axis}"]) for axis in ("east", "north", "up")],
            axis=1,
        )
        for name in ("position", "velocity")
    ]
    check_latency(seen, columns[0], columns[1])
    check_against_stand(recording, 0.3, 0.03)


ORACLES: dict[str, Callable[[Recording], None]] = {
    "static": static,
    "multi_position": multi_position,
    "rotation": rotation,
    "rate_staircase": rate_staircase,
    "tumble": tumble,
    "swing": swing,
    "sweep": sweep,
    "spin": spin,
    "satellite_static": satellite_static,
    "satellite_trajectory": satellite_trajectory,
    "vehicle_run": vehicle_run,
}
