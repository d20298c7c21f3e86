"""A recording says how it is to be understood: y = M u + b, then filter, noise, quantiser.

u comes from the stand's stream alone, with the Earth's rate added here where `believed.earth_rate` says so.
For units that have nothing but what `believed` can say, on stands without errors, what is left is white noise
of the unit's density, slow noise and this power-on's bias. Nothing is imported that made the recording.
"""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.effect import name_of
from dut_emulator.motion.profile import ProfileKind
from dut_emulator.motion.profile_catalogue import PROFILES
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.order import LABORATORY
from dut_emulator.recording.recorder import recorded
from dut_emulator.stands.catalogue import recording_stand
from dut_emulator.twin import Twin
from protocol.recordings import Recording
from protocol.units_of_measure import is_known_unit

DEG, G = math.pi / 180, 9.80665
SI = {"deg/s": DEG, "rad/s": 1.0, "g": G, "m/s^2": 1.0, "uT": 1e-6, "gauss": 1e-4, "V": 1.0}
SAYABLE = {
    *("misalignment", "cross_axis_sensitivity", "soft_iron", "scale_factor_error", "bias", "hard_iron"),
    *("white_noise", "bias_instability", "bandwidth", "saturation", "quantization"),
}
CASES = [
    ("fog", "static", {}),
    ("fog", "rate_staircase", {}),
    ("rate_gyro_triad", "static", {"duration_s": 300.0}),
    ("rate_gyro_triad", "eleven_point", {"cycles": 1.0, "axis": 2.0}),
    ("mems_ahrs", "static", {}),
    ("mems_ahrs", "rotation", {}),
    ("mems_ahrs", "rate_staircase", {}),
    ("gnc_module", "multi_position", {}),
    ("gnc_module", "sweep", {}),
    ("gnc_module", "tumble", {}),
]
LARGEST_MEAN = {"gyro": 0.04 * DEG, "acc": 2.5e-3 * G, "mag": 1e-7}
"""Turn-on and slow noise of MEMS; a FOG has next to none."""
FOG_MEAN = 1.0 * DEG / 3600


def only_sayable(product_name: str, profile: str) -> Twin:
    """A unit of the lot with what `believed` can say, and the stand's errors at nothing."""
    product = product_named(product_name)
    drawn = product.twin(3, "U-0007")
    own = [effect for effect in drawn.effects if effect.word in SAYABLE]
    sensors = {effect.sensor for effect in own} | {"temperature"}
    stand = recording_stand(product.profiles[profile].stand, 1, LABORATORY)
    still = [effect_named(name_of(one), one.sensor) for one in stand.effects if one.sensor in sensors]
    return Twin(drawn.product, (*still, *own))


def recording_of(product: str, profile: str, values: dict[str, float]) -> tuple[Recording, Twin]:
    twin = only_sayable(product, profile)
    return recorded(product, profile, values=values, twin=twin, seed=3, serial="U-0007"), twin


def inputs(recording: Recording, sensor: str) -> np.ndarray:
    """(n, 3) SI at the unit's instants: the stand's stream, and the Earth's rate by its angles."""
    stand, times = recording.streams["stand"], recording.streams["dut"].columns["t"]

    def column(name: str, unit: float) -> np.ndarray:
        return np.interp(times, stand.columns["t"], stand.columns[name]) * unit

    word = {"gyro": "rate", "acc": "acc", "mag": "mag"}[sensor]
    said = np.stack([column(f"{word}_{a}", SI[stand.units[f"{word}_{a}"]]) for a in "xyz"], axis=1)
    if sensor != "gyro" or not recording.believed.get("earth_rate"):
        return said
    outer, middle, inner = (column(f"angle_{name}", DEG) for name in ("outer", "middle", "inner"))
    latitude = recording.site["latitude_deg"] * DEG
    north, up = 7.292115e-5 * math.cos(latitude), 7.292115e-5 * math.sin(latitude)  # heading 0: y is north
    x, y = north * np.sin(outer), north * np.cos(outer)
    x, z = x * np.cos(middle) - up * np.sin(middle), x * np.sin(middle) + up * np.cos(middle)
    y, z = y * np.cos(inner) + z * np.sin(inner), z * np.cos(inner) - y * np.sin(inner)
    return said + np.stack([x, y, z], axis=1)


def outputs(recording: Recording, sensor: str) -> np.ndarray:
    """(n, 3) SI; a column that the unit has not is NaN."""
    dut, believed = recording.streams["dut"], recording.believed[sensor]
    found = np.full((len(dut.columns["t"]), 3), np.nan)
    for index, axis in enumerate("xyz"):
        if f"volt_{axis}" in dut.columns:
            found[:, index] = dut.columns[f"volt_{axis}"] / believed["volts_per_unit"] * SI[believed["unit"]]
        elif "counts" in believed and f"{sensor}_{axis}" in dut.columns:
            counts = dut.columns[f"{sensor}_{axis}"] - float(believed["counts"]["at_zero"])
            found[:, index] = counts / believed["counts"]["per_unit"] * SI[believed["unit"]]
        elif f"{sensor}_{axis}" in dut.columns:
            found[:, index] = dut.columns[f"{sensor}_{axis}"] * SI[dut.units[f"{sensor}_{axis}"]]
    return found


def modelled(believed: dict[str, Any], u: np.ndarray, period_s: float) -> np.ndarray:
    """M u + b behind one pole, exact for inputs that are straight between samples."""
    y = u @ np.array(believed["matrix"]).T + np.array(believed["bias"]) * SI[believed["unit"]]
    if not believed["bandwidth_hz"]:
        return y
    ratio = 1.0 / (2.0 * math.pi * believed["bandwidth_hz"] * period_s)
    alpha = math.exp(-1.0 / ratio)
    held = ratio * (1.0 - alpha)
    feed = [1.0 - held, held - alpha]
    state = (1.0 - feed[0]) * y[:1]  # settled before the first sample
    return lfilter(feed, [1.0, -alpha], y, axis=0, zi=state)[0]


@pytest.mark.parametrize(("product", "profile", "values"), CASES)
def test_believed_and_the_stands_stream_leave_noise_only(
    product: str, profile: str, values: dict[str, float]
) -> None:
    recording, twin = recording_of(product, profile, values)
    period_s = float(np.median(np.diff(recording.streams["dut"].columns["t"])))
    words = {(effect.sensor, effect.word): effect for effect in twin.effects}
    for sensor in ("gyro", "acc", "mag"):
        if sensor not in recording.believed:
            continue
        u, y = inputs(recording, sensor), outputs(recording, sensor)
        rest = y - modelled(recording.believed[sensor], u, period_s)
        quantum = (recording.believed[sensor]["quantum"] or 0.0) * SI[recording.believed[sensor]["unit"]]
        noise: Any = words[sensor, "white_noise"]
        for axis in range(3):
            if np.isnan(y[0, axis]):
                continue
            left = rest[:, axis]
            largest = FOG_MEAN if product == "fog" else LARGEST_MEAN[sensor]
            assert abs(left.mean()) < largest
            density = math.hypot(noise.density_si_per_sqrt_hz[axis], quantum * math.sqrt(period_s / 12.0))
            high, low = densities(left, period_s)
            assert high == pytest.approx(density, rel=0.05), (sensor, axis)
            assert low == pytest.approx(density, rel=0.1), (sensor, axis)


@pytest.mark.parametrize(("product", "rate_hz"), [("mems_ahrs", 200.0), ("gnc_module", 200.0)])
def test_a_link_that_is_late_does_not_smooth_the_noise(product: str, rate_hz: float) -> None:
    """Half a period of delay, between samples, would take 30 % off the noise and all of its highest part."""
    twin = only_sayable(product, "rate_staircase")
    for sensor in ("gyro", "acc", "mag"):
        if any(effect.sensor == sensor for effect in twin.effects):
            late = dataclasses.replace(effect_named("link.fixed_delay", sensor), delay_s=2.5 / rate_hz)
            twin = twin.with_effect(late)
    density: Any = next(e for e in twin.effects if (e.sensor, e.word) == ("gyro", "white_noise"))
    for profile in ("static", "rate_staircase"):
        recording = recorded(product, profile, twin=twin, seed=3, serial="U-0007")
        dut, stand = (recording.streams[name].columns for name in ("dut", "stand"))
        shown = np.interp(dut["t"] - 2.5 / rate_hz, stand["t"], stand["rate_z"])
        rest = (dut["gyro_z"] - shown * recording.believed["gyro"]["matrix"][2][2]) * DEG
        high, _ = densities(rest, 1.0 / rate_hz)
        assert high == pytest.approx(density.density_si_per_sqrt_hz[2], rel=0.05)


def test_a_clock_that_drifts_leaves_an_attitude_units_noise_alone() -> None:
    """20 ppm are 2.4 ms after two minutes: half a period of the samples."""
    twin = only_sayable("mems_ahrs", "static")
    for sensor in ("gyro", "acc"):
        drift = dataclasses.replace(effect_named("link.clock_drift", sensor), relative_rate=20e-6)
        twin = twin.with_effect(drift)
    recording = recorded("mems_ahrs", "static", twin=twin, seed=3, serial="U-0007")
    density: Any = next(e for e in twin.effects if (e.sensor, e.word) == ("gyro", "white_noise"))
    last = recording.streams["dut"].columns["gyro_x"][-8000:] * DEG
    assert densities(last, 0.005)[0] == pytest.approx(density.density_si_per_sqrt_hz[0], rel=0.05)


def densities(rest: np.ndarray, period_s: float) -> tuple[float, float]:
    """Of the highest octave, and of the two from a sixteenth to a quarter of half the sampling rate."""
    power = np.abs(np.fft.rfft(rest - rest.mean())) ** 2 * period_s / len(rest)
    top = len(power)
    return math.sqrt(power[top // 2 :].mean()), math.sqrt(power[top // 16 : top // 4].mean())


@pytest.mark.parametrize(("profile", "sensor"), [("static", "acc"), ("multi_position", "gyro")])
def test_pulses_add_up_to_the_believed_integral(profile: str, sensor: str) -> None:
    recording, _ = recording_of("pulse_imu", profile, {})
    dut, believed = recording.streams["dut"].columns, recording.believed[sensor]
    per_si = believed["pulses_per_unit_s"] / SI[believed["unit"]]
    rate = modelled(believed, inputs(recording, sensor), 0.01) * per_si
    wanted = np.concatenate([np.zeros((1, 3)), np.cumsum((rate[1:] + rate[:-1]) * 0.005, axis=0)])
    counted = np.stack(
        [np.cumsum(dut[f"pulse_{sensor}_{a}_pos"] - dut[f"pulse_{sensor}_{a}_neg"]) for a in "xyz"], axis=1
    )
    turn_on = {"gyro": 0.4 * DEG / 3600, "acc": 80e-6 * G}[sensor] * per_si * dut["t"][-1]
    assert np.abs(counted - wanted).max() < 3.0 + turn_on + 20.0 * (profile == "multi_position")


def test_the_earths_rate_does_not_turn_with_a_crank() -> None:
    """A rig's crank turns no unit: its angle is no gimbal's, else the Earth's rate would follow it."""
    recording, _ = recording_of("pulse_imu", "overload", {"cycles": 4.0})
    angles = {name for name in recording.streams["stand"].columns if name.startswith("angle_")}
    assert recording.believed["earth_rate"]
    assert angles == {"angle_crank"}


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda kind: kind.name)
def test_units_of_profiles_are_known(profile: ProfileKind) -> None:
    assert [one.name for one in profile.parameters if not is_known_unit(one.unit)] == []


def test_the_noise_of_a_magnetometer_is_told() -> None:
    recording, _ = recording_of("gnc_module", "static", {})
    told, rest = recording.believed["mag"]["white_noise"], outputs(recording, "mag")
    assert (told["unit"], told["value"] * 1e-6) == ("uT/sqrt(Hz)", pytest.approx(5e-8 / math.sqrt(200.0)))
    for axis in range(3):
        assert densities(rest[:, axis], 0.005)[0] == pytest.approx(told["value"] * 1e-6, rel=0.05)


def test_noise_is_the_outputs_wherever_it_is_listed() -> None:
    """White up to half the sampling rate, though the sensor has a pole below it."""
    product = product_named("mems_ahrs")
    twin = product.twin(1, "U-0001")
    chain = twin.chain("gyro")
    words = [effect.word for effect in chain.effects]
    assert words.index("bandwidth") < words.index("white_noise") < words.index("saturation")
    again = dataclasses.replace(twin, effects=twin.effects).chain("gyro")
    assert again.names == chain.names
