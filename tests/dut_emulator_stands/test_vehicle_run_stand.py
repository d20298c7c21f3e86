"""A vehicle with its reference: what is refused, what the reference says, the port's commands."""

import math

import numpy as np
import pytest

from dut_emulator.effects.stand import RemountMisalignment
from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.course import PHASES
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.vehicle_run_stand.stand import READING_UNITS
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.units_of_measure import is_known_unit

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=40.0)


def run(profile: str, **values: float):
    return recording_stand("vehicle_run_stand", 5, SITE).run(profile, profile_named(profile).values(values))


@pytest.mark.parametrize(
    ("profile", "values", "limit"),
    [
        ("flight", {"speed_m_s": 95.0}, "speed"),
        ("flight", {"bank_deg": 65.0}, "bank"),
        ("flight", {"bank_deg": 59.0}, "load factor"),
        ("vehicle_run", {"speed_m_s": 45.0}, "speed"),
        ("vehicle_run", {"cornering_m_s2": 7.0}, "cornering"),
    ],
)
def test_beyond_a_limit_nothing_runs(profile: str, values: dict[str, float], limit: str) -> None:
    with pytest.raises(TestloomError, match=f"The {limit} of .* is above the limit"):
        run(profile, **values)


def test_a_car_has_a_least_turning_circle() -> None:
    with pytest.raises(TestloomError, match=r"radius of 0.8 m is below the car's least, 5 m"):
        run("vehicle_run", speed_m_s=2.0)


def test_another_stands_profile_is_refused() -> None:
    with pytest.raises(TestloomError, match="neither a drive nor a flight"):
        run("static")


@pytest.mark.parametrize("profile", ["flight", "vehicle_run"])
def test_the_reference_reads_the_truth_within_its_own_stated_errors(profile: str) -> None:
    made = run(profile, vibration_m_s2=0.0)
    times = np.arange(0.0, made.duration_s, 0.1)
    read, true = made.reading(times), made.stimulus(times)
    assert list(read) == list(READING_UNITS)
    assert all(is_known_unit(unit) for unit in made.reading_units.values())
    dcm = true.channel("dcm_local_from_body")
    yaw = np.degrees(np.arctan2(dcm[:, 0, 0], dcm[:, 1, 0]))
    pitch = np.degrees(np.arcsin(dcm[:, 2, 0]))
    roll = np.degrees(np.arctan2(dcm[:, 2, 1], dcm[:, 2, 2]))
    for name, angle, rms in (("roll", roll, 0.01), ("pitch", pitch, 0.01), ("yaw", yaw, 0.03)):
        error = (read[name] - angle + 180.0) % 360.0 - 180.0
        assert 0.2 * rms < np.sqrt(np.mean(error**2)) < 2.5 * rms, name
    turning = np.degrees(true.channel("rate_rad_s") - true.channel("earth_rate_rad_s"))
    for index, axis in enumerate("xyz"):
        assert np.abs(read[f"rate_{axis}"] - turning[:, index]).max() <= 0.5001e-3
        force = true.channel("specific_force_m_s2")[:, index] / 9.80665
        assert np.abs(read[f"acc_{axis}"] - force).max() <= 0.5001e-5
    for index, axis in enumerate(("east", "north", "up")):
        error = read[f"position_{axis}"] - true.channel("position_m")[:, index]
        assert 0.01 < np.sqrt(np.mean(error**2)) < 0.13
    assert read["temp"][0] == pytest.approx(23.0)


def test_phases_are_events_and_two_seeds_are_two_vehicles() -> None:
    made = run("flight")
    (events,) = made.events()
    assert [PHASES[code] for code in events.columns["phase"]][:3] == ["rest", "take_off", "climb"]
    assert (np.diff(events.columns["t"]) > 0).all()
    assert events.columns["t"][-1] < made.duration_s
    one, other = (recording_stand("vehicle_run_stand", seed, SITE) for seed in (1, 2))
    assert one.effects != other.effects
    assert one.effects == recording_stand("vehicle_run_stand", 1, SITE).effects
    rotations = {effect.rotation_rad for effect in one.effects if isinstance(effect, RemountMisalignment)}
    assert len(rotations) == 1  # one plate carries all triads
    assert {effect.sensor for effect in one.effects} == {"gyro", "acc", "mag"}


def test_the_port_starts_reports_and_stops() -> None:
    live = live_stand("vehicle_run_stand", 5, SITE, "VR-0005,Testloom")
    port = live.port
    assert port.command("*IDN?", 0.0).startswith("Testloom,VRS,")
    assert port.command("LIM?", 0.0) == "40,6,5,90,60,1.9"
    assert port.command("CAL?", 0.0) == recording_stand("vehicle_run_stand", 5, SITE).identity.calibration_due
    assert port.command("STAT?", 0.0).startswith("READY,rest,0.0")
    assert port.command("START flight,bank_deg=70", 1.0).startswith("ERR 12 The bank of 70 deg")
    assert port.command("START flight,bank=70", 1.0).startswith("ERR 15")
    assert port.command("START swing", 1.0).startswith("ERR 15")
    assert port.command("FLY", 1.0).startswith("ERR 1 ")
    assert port.command("STOP now", 1.0).startswith("ERR 2 ")
    duration_s = float(port.command("START vehicle_run,speed_m_s=12,duration_scale=0.5", 1.0).split()[1])
    assert port.command("START flight", 2.0).startswith("ERR 10")
    begins = dict(item.split("=") for item in port.command("PHAS?", 2.0).split(","))
    now_s = 1.0 + float(begins["turn"]) + 4.0
    state, phase, *figures = port.command("STAT?", now_s).split(",")
    assert (state, phase) == ("MOVING", "turn")
    assert float(figures[3]) == pytest.approx(12.0)
    braking_s = float(port.command("STOP", now_s).split()[1])
    assert 3.0 <= braking_s < duration_s - now_s
    assert port.command("STAT?", now_s + braking_s / 2).startswith("MOVING,stop")
    state, _, *figures = port.command("STAT?", now_s + braking_s).split(",")
    assert state == "READY"
    assert float(figures[3]) == pytest.approx(0.0, abs=1e-9)


def test_an_aircraft_stops_on_the_ground_only() -> None:
    port = live_stand("vehicle_run_stand", 5, SITE, "VR").port
    port.command("START flight", 0.0)
    begins = dict(item.split("=") for item in port.command("PHAS?", 0.0).split(","))
    assert port.command("STOP", float(begins["cruise"])).startswith("ERR 16")
    port.inject("door_open", float(begins["cruise"]) + 1.0)
    assert port.command("STAT?", float(begins["cruise"]) + 2.0).startswith("FAULT,cruise")
    other = live_stand("vehicle_run_stand", 5, SITE, "VR").port
    other.command("START flight", 0.0)
    assert other.command("STOP", float(begins["take_off"]) + 5.0).startswith("OK")


def test_faults_keep_it_from_starting() -> None:
    port = live_stand("vehicle_run_stand", 5, SITE, "VR").port
    with pytest.raises(BenchModelError, match="rate_not_reached"):
        port.inject("rate_not_reached", 0.0)
    for fault, code, state in (("door_open", 13, "FAULT"), ("reference_lost", 11, "NOREF")):
        port.inject(fault, 0.0)
        assert port.command("START vehicle_run", 0.0).startswith(f"ERR {code} ")
        assert port.command("STAT?", 0.0).startswith(state)
    port.inject("none", 0.0)
    assert port.command("START vehicle_run", 0.0).startswith("OK")
    port.inject("door_open", 30.0)
    assert port.command("STAT?", 60.0).startswith("FAULT,stop")


def test_the_stream_is_the_reading_and_has_no_numbers_without_a_reference() -> None:
    port = live_stand("vehicle_run_stand", 5, SITE, "VR").port
    port.command("START vehicle_run", 2.0)
    assert port.command("STRE ON,600", 2.0).startswith("ERR 2")
    assert port.command("STRE ON,50", 2.0) == "OK"
    first = port.advance(20.0)
    port.inject("reference_lost", 21.0)
    rows = np.frombuffer(first + port.advance(22.0), "<f8").reshape(-1, 1 + len(READING_UNITS))
    assert len(rows) == 1001
    assert np.array_equal(rows[:, 0], 2.0 + np.arange(1001) / 50)
    lost = rows[:, 0] > 21.0
    assert np.isnan(rows[lost, 1:]).all()
    expected = run("vehicle_run").reading(rows[~lost, 0] - 2.0)
    for index, name in enumerate(READING_UNITS, start=1):
        assert np.array_equal(rows[~lost, index], expected[name])


def test_what_acts_on_the_bench_follows_the_commands_in_any_chunks() -> None:
    live = live_stand("vehicle_run_stand", 5, SITE, "VR")
    live.port.command("START vehicle_run", 3.0)
    made = run("vehicle_run")
    times = np.arange(0.0, 60.0, 0.05)
    whole = live.surroundings.stimulus(times)
    assert np.array_equal(whole.time_s, times)
    assert np.allclose(whole.channel("rate_rad_s")[0], made.stimulus(np.zeros(1)).channel("rate_rad_s")[0])
    later = times >= 3.0
    assert np.array_equal(
        whole.channel("specific_force_m_s2")[later],
        made.stimulus(times[later] - 3.0).channel("specific_force_m_s2"),
    )
    parts = [
        live.surroundings.stimulus(times[k : k + 7]).channel("position_m") for k in range(0, len(times), 7)
    ]
    assert np.array_equal(np.concatenate(parts), whole.channel("position_m"))
    assert math.isnan(whole.sample_period_s)
