"""The pure lag: exact between frames, found back by the calibration inside its bounds (paper 3)."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.algorithms.impact_detection import detect_impact
from calibration.algorithms.pure_lag import PAPER_STAMPS, PureLag, pure_lag
from dut_emulator.effects.dynamics import Bandwidth, FixedDelay
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.products.fog.population import draw_twin
from dut_emulator.products.fog.sensor import FogSensor
from dut_emulator.recording.recorder import recorded
from dut_emulator.stands.catalogue import recording_stand
from dut_emulator.stands.impact_rig.rig import ImpactRun
from dut_emulator.twin import Twin
from protocol.bench_description import Site
from protocol.errors import CalibrationError

SITE = Site(latitude_deg=39.96, gravity_m_s2=9.8013)
US = 1e-6
COUNTS_PER_RAD_S = 20_000 * 180 / math.pi
RIG_DELAY_S = 0.08 * US  # trigger latency up to 60 ns and its jitter
SIGHT_S = 0.2 * US  # until the pole lets 5 sigma of a 40 deg/s step through: tau ln(1 - 1000/800000)


def acting_rate(rate_rad_s, temperature_c: float = 25.0):
    """What acts: a rate about body z as a function of time, at one temperature of the mount."""

    def acting(times_s: np.ndarray) -> Stimulus:
        rate = np.zeros((len(times_s), 3))
        rate[:, 2] = rate_rad_s(times_s)
        return Stimulus(times_s, np.full(len(times_s), temperature_c), math.nan, rate_rad_s=rate)

    return acting


def sensor_with(*effects, power_on_s: float = 0.0) -> FogSensor:
    return FogSensor(Twin("fog", effects), (), np.random.SeedSequence(5), power_on_s)


@settings(max_examples=60, deadline=None)
@given(
    lag_us=st.floats(190.0, 3000.0),
    impact_us=st.floats(20_000.0, 30_000.0),
    rate_hz=st.sampled_from([500, 1500, 2000, 4000]),
)
def test_the_first_frame_that_shows_an_impact_is_the_first_after_impact_and_lag(
    lag_us: float, impact_us: float, rate_hz: int
) -> None:
    impact_s = impact_us * US
    sensor = sensor_with(FixedDelay("gyro", lag_us * US))
    lag_s = float(sensor.lag_s(rate_hz, np.array([25.0]))[0])
    received_s = np.arange(round(0.04 * rate_hz)) / rate_hz
    samples = sensor.sample(received_s, rate_hz, acting_rate(lambda t: 0.5 * (t >= impact_s)))
    first = received_s[np.flatnonzero(samples.rate > 2000)[0]]
    # 3 C of self-heating have come in by 25 us at most, a part in 1e8 of the processing
    due = math.ceil((impact_s + lag_s) * rate_hz - 1e-6) / rate_hz
    assert first == pytest.approx(due, abs=1e-9)
    assert set(samples.rate.tolist()) == {2000, 2000 + round(0.5 * COUNTS_PER_RAD_S)}


def test_the_lag_follows_frame_rate_and_temperature_as_stated() -> None:
    sensor = sensor_with(FixedDelay("gyro", 242.23 * US))
    temperature_c = np.array([25.0, -40.0, 70.0])
    processing_s = 242.23 * US - 120 / 921_600 - 0.1 * 500 * US
    assert processing_s == pytest.approx(62.0217 * US, abs=1e-10)
    at_2_khz = 242.23 * US + processing_s * 5e-4 * np.array([0.0, -65.0, 45.0])
    np.testing.assert_allclose(sensor.lag_s(2000, temperature_c), at_2_khz, rtol=1e-12)
    np.testing.assert_allclose(sensor.lag_s(500, temperature_c), at_2_khz + 150 * US, rtol=1e-12)
    np.testing.assert_allclose(sensor.lag_s(4000, temperature_c), at_2_khz - 25 * US, rtol=1e-12)


def test_the_loops_pole_follows_a_step_between_frames_and_a_sine() -> None:
    tau = 53 * US
    received_s = np.arange(200) / 2000
    impacts = np.linspace(0.05, 0.0505, 40, endpoint=False)
    for impact_s in impacts.tolist():
        sensor = sensor_with(Bandwidth("gyro", tau), FixedDelay("gyro", 242.23 * US))
        samples = sensor.sample(received_s, 2000, acting_rate(lambda t, at=impact_s: 0.7 * (t >= at)))
        since = np.maximum(received_s - 242.23 * US - impact_s, 0.0)
        expected = 0.7 * COUNTS_PER_RAD_S * -np.expm1(-since / tau)
        np.testing.assert_allclose(samples.rate - 2000, expected, atol=0.7 * COUNTS_PER_RAD_S / 1000)
    omega = 2 * math.pi * 80.0
    sensor = sensor_with(Bandwidth("gyro", tau), FixedDelay("gyro", 242.23 * US))
    samples = sensor.sample(received_s, 2000, acting_rate(lambda t: np.sin(omega * t)))
    gain, phase = 1 / math.hypot(1, omega * tau), math.atan(omega * tau)
    expected = gain * np.sin(omega * (received_s - 242.23 * US) - phase) * COUNTS_PER_RAD_S
    np.testing.assert_allclose(samples.rate[4:] - 2000, expected[4:], atol=1e-5 * COUNTS_PER_RAD_S)


def first_frames(
    run: ImpactRun, twin: Twin, seed: int, rate_hz: float = 2000.0, rest: int = 60, after: int = 20
) -> np.ndarray:
    """(k,) stamps of the first frames that show each impact: what the rig's records hold, windows only."""
    sensor = FogSensor(twin, (), np.random.SeedSequence(seed), -3600.0)
    before = np.floor(run.impact_times_s * rate_hz)[:, np.newaxis]
    received_s = (before + np.arange(1 - rest, after)) / rate_hz
    samples = sensor.sample(received_s.ravel(), rate_hz, run.stimulus)
    stamped = run.stamps(received_s.ravel()).reshape(received_s.shape)
    outputs = samples.rate.reshape(received_s.shape).astype(float)
    triggered = (stamped >> 15).argmax(axis=1)
    frames = [detect_impact(*shot).frame for shot in zip(outputs, triggered.tolist(), strict=True)]
    return stamped[np.arange(len(frames)), frames]


def lag_of(stamps: np.ndarray, frame_s: float) -> PureLag:
    """By the calibration, from stamps as the rig sends them."""
    assert (stamps >> 15).all()
    return pure_lag(PAPER_STAMPS.seconds((stamps & 0x7FFF).astype(np.int64)), frame_s)


def impact_run(stand_seed: int, **values: float) -> ImpactRun:
    kind = profile_named("impact")
    run = recording_stand("impact_rig", stand_seed, SITE).run("impact", kind.values(values))
    assert isinstance(run, ImpactRun)
    return run


def twin_with_lag(lag_s: float, serial: str = "U-0001") -> Twin:
    return draw_twin(1, serial).with_effect(FixedDelay("gyro", lag_s))


@pytest.mark.parametrize("lag_us", [242.23, 347.55, 15.0, 495.0, 1242.23, 2910.0])
def test_calibration_finds_the_lag_whatever_it_is_to_a_frame(lag_us: float) -> None:
    run = impact_run(7, shots=100)
    found = lag_of(first_frames(run, twin_with_lag(lag_us * US), seed=1), 500 * US)
    # 26 C after an hour: the mount's 23 and 3 of self-heating
    lag_s = float(
        sensor_with(FixedDelay("gyro", lag_us * US), power_on_s=-1e6).lag_s(2000, np.array([26.0]))[0]
    )
    assert found.lower_s - SIGHT_S <= lag_s <= found.upper_s + RIG_DELAY_S
    assert found.half_width_s < 25 * US
    assert found.lag_s == pytest.approx(lag_s, abs=20 * US)


def test_bounds_hold_for_every_rig_and_are_as_wide_as_the_closed_form_says() -> None:
    """K = 31, 25 µs at 2 kHz: P(half width) = 0.830435 (corrected eq. (22); the paper's own says 0.99)."""
    rigs, within = 120, 0
    twin = twin_with_lag(242.23 * US)
    quiet = dataclasses.replace(
        twin, effects=tuple(one for one in twin.effects if not isinstance(one, Bandwidth))
    )
    for rig in range(rigs):
        found = lag_of(first_frames(impact_run(rig, shots=31), quiet, seed=rig, rest=31, after=5), 500 * US)
        assert found.lower_s <= 242.27 * US
        assert found.upper_s + RIG_DELAY_S >= 242.23 * US
        within += found.half_width_s - PAPER_STAMPS.resolution_s / 2 <= 25 * US
    spread = math.sqrt(0.830435 * (1 - 0.830435) / rigs)
    assert within / rigs == pytest.approx(0.830435, abs=4 * spread)


def test_programmed_instants_take_few_shots() -> None:
    """The paper's outlook: phases spread evenly leave T / K for certain, where random ones leave more."""
    run = impact_run(3, shots=16, next_frame_us=10.0, step_us=500.0 / 16)
    found = lag_of(first_frames(run, twin_with_lag(347.55 * US), seed=2), 500 * US)
    assert found.half_width_s == pytest.approx(500 / 16 / 2 * US, abs=12 * US)  # 2 us of the rig's instants
    assert found.lower_s <= 347.7 * US
    assert found.upper_s >= 347.4 * US


def test_a_lag_beyond_the_timer_saturates_the_stamps_and_is_refused() -> None:
    stamps = first_frames(impact_run(1, shots=5), twin_with_lag(3900 * US), seed=1)
    assert (stamps == 0xFFFF).all()
    with pytest.raises(CalibrationError, match="end of the timer"):
        lag_of(stamps, 500 * US)


@pytest.mark.parametrize(
    ("serial", "rate_hz", "lag_us"),
    [
        ("A-0003", 2000, 242.23),
        ("B-0003", 2000, 347.55),
        ("A-0003", 4000, 242.23 - 25.0),  # a tenth of the frame's period belongs to the lag
        ("A-0003", 800, 242.23 + 75.0),
    ],
)
def test_a_recorded_unit_of_each_type_gives_its_lag(serial: str, rate_hz: int, lag_us: float) -> None:
    values = {"shots": 20.0, "spacing_s": 0.9, "frame_rate_hz": float(rate_hz)}
    recording = recorded("fog", "impact", values=values, serial=serial, stand_seed=2)
    dut = recording.streams["dut"].columns
    assert dut["stamp"].dtype == np.uint16
    stamps = []
    for slot in range(20):
        inside = slice(round(slot * 0.9 * rate_hz), round((slot + 1) * 0.9 * rate_hz))
        stamped = dut["stamp"][inside]
        first = int((stamped >> 15).argmax())
        outputs = dut["gyro_z"][inside][: first + 20].astype(float)
        stamps.append(stamped[detect_impact(outputs, first).frame])
    found = lag_of(np.array(stamps), 1 / rate_hz)
    lag_s = next(e.delay_s for e in draw_twin(1, serial).effects if isinstance(e, FixedDelay))
    lag_s += 0.1 * (1 / rate_hz - 1 / 2000)
    assert lag_s == pytest.approx(lag_us * US, abs=7.5 * US)  # three deviations of lot and unit
    assert found.lower_s - SIGHT_S <= lag_s <= found.upper_s + RIG_DELAY_S + 0.2 * US
