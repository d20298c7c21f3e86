"""The FOG's output at rest, its population, and the unit on a bench: broadcast, query, stamps."""

import math

import numpy as np
import pytest

from calibration.algorithms.impact_detection import detect_impact
from calibration.algorithms.pure_lag import PAPER_STAMPS, pure_lag
from calibration.algorithms.pure_lag_shots import next_frame_after_impact_s, programmed_shots_needed
from dut_emulator.effects.catalogue import CATALOGUE, candidate, effect_named
from dut_emulator.effects.dynamics import FixedDelay
from dut_emulator.effects.stochastic import WhiteNoise
from dut_emulator.products.catalogue import product_named
from dut_emulator.products.fog import FogUnit, make_unit
from dut_emulator.products.fog.population import draw_twin
from dut_emulator.products.product import UnitOnStand
from dut_emulator.recording.recorder import recorded
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.twin import Twin, parse_twin, twin_text
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.fog import FRAME_BYTES, FRAME_DTYPE, Command, FogFrameParser, FrameStatus, encode_command
from protocol.impact_rig import RECORD_DTYPE

SITE = Site(latitude_deg=39.96, gravity_m_s2=9.8013)
EARTH_UP_DEG_S = 15.041067 / 3600 * math.sin(math.radians(39.96))
IMPACT = {"shots": 2.0, "spacing_s": 0.9}


def on_rig(rate_hz: float, twin: Twin | None = None) -> UnitOnStand:
    run = recording_stand("impact_rig", 1, SITE).run(
        "impact",
        {"peak_rate_deg_s": 40.0, "next_frame_us": -1.0, "step_us": 0.0, "frame_rate_hz": rate_hz} | IMPACT,
    )
    return UnitOnStand(
        twin or draw_twin(1, "U-0001"), (), run, rate_hz, np.random.SeedSequence(3), "U-0001", -3600.0
    )


def test_at_rest_it_says_2000_with_200_counts_of_noise_at_2_khz() -> None:
    board = LevelBoard(SITE)
    (noise,) = (one for one in draw_twin(1, "U-0007").effects if isinstance(one, WhiteNoise))
    unit = FogUnit(1, "U-0007", Twin("fog", (noise,)))
    share = noise.density_si_per_sqrt_hz[2] / (200 / 20_000 * math.pi / 180 / math.sqrt(2000))
    assert 0.85 < share < 1.18  # three deviations of 5 %
    unit.insert(board, 0.0)
    unit.set_supply(5.0, 0.0)
    unit.receive("rs422", encode_command(Command.BROADCAST, 10), 1.0, None)
    unit.advance(10_000.0)
    for start_s, rate_hz in ((10_000.0, 2000), (10_100.0, 500), (10_200.0, 4000)):
        unit.receive("rs422", encode_command(Command.BROADCAST, rate_hz), start_s, None)
        unit.advance(start_s)
        frames = FogFrameParser().feed(b"".join(sent.data for sent in unit.advance(start_s + 20.0)))
        unit.receive("rs422", encode_command(Command.QUERY_MODE), start_s + 20.0, None)
        assert len(frames) == 20 * rate_hz
        rates = frames["rate"].astype(float)
        sigma = 200 * share * math.sqrt(rate_hz / 2000)
        # 20 s of noise: mean to 5 sigma / sqrt(n), deviation to 5 / sqrt(2n)
        assert rates.mean() == pytest.approx(
            2000 + 20_000 * EARTH_UP_DEG_S, abs=5 * sigma / math.sqrt(len(rates))
        )
        assert rates.std() == pytest.approx(sigma, rel=5 / math.sqrt(2 * len(rates)))
        assert (np.diff(frames["counter"].astype(int)) % 256 == 1).all()
    assert frames["temperature"][-1] == 2600  # 23 of the room and 3 of its own


def test_chunks_make_no_difference() -> None:
    product = product_named("fog")
    whole = product.begin(on_rig(2000.0)).advance(1.8)["dut"]
    stream = product.begin(on_rig(2000.0))
    pieces = [stream.advance(to_s)["dut"] for to_s in (0.0, 0.1037, 0.10371, 0.2, 0.95, 1.0123, 1.8)]
    for name, samples in whole.items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), samples)
    assert len(whole["t"]) == 3601


def test_a_lost_frame_leaves_a_hole_and_its_number() -> None:
    twin = draw_twin(1, "U-0001")
    lossy = Twin("fog", (*twin.effects, effect_named("link.frame_loss", "gyro", probability=0.1)))
    columns = product_named("fog").begin(on_rig(2000.0, lossy)).advance(1.0)["dut"]
    numbers = np.round(columns["t"] * 2000).astype(int)
    assert 1700 < len(numbers) < 1900
    np.testing.assert_array_equal(columns["counter"], (numbers % 256).astype(np.uint8))
    assert {len(samples) for samples in columns.values()} == {len(numbers)}


GYRO_EFFECTS = [name for name, (_, sensors) in CATALOGUE.items() if "gyro" in sensors]


@pytest.mark.parametrize("name", GYRO_EFFECTS)
def test_any_effect_of_a_gyro_can_be_in_its_twin(name: str) -> None:
    lag = next(one for one in draw_twin(1, "U-0001").effects if isinstance(one, FixedDelay))
    one = candidate(name, "gyro")
    effects = sorted((one, *(() if isinstance(one, FixedDelay) else (lag,))), key=lambda effect: effect.stage)
    columns = product_named("fog").begin(on_rig(2000.0, Twin("fog", tuple(effects)))).advance(0.2)["dut"]
    assert len(columns["t"]) > 300
    assert columns["gyro_z"].dtype == np.int32


def test_what_cannot_be_is_refused() -> None:
    product = product_named("fog")
    with pytest.raises(TestloomError, match="8000 frames a second"):
        product.begin(on_rig(8000.0))
    with pytest.raises(TestloomError, match="sensor 'acc'"):
        product.begin(on_rig(2000.0, Twin("fog", (effect_named("acc.bias"),))))
    with pytest.raises(TestloomError, match="sensor 'acc'"):
        make_unit(1, "U-0001", None, Twin("fog", (effect_named("acc.bias"),)))


def test_the_lots_gyros_are_two_types_of_a_tactical_gyro() -> None:
    for kind, paper_s in (("A", 242.23e-6), ("B", 347.55e-6)):
        serials = [f"{kind}-{number:04d}" for number in range(40)]
        twins = [draw_twin(4, serial) for serial in serials if not product_named("fog").defects(4, serial)]
        lags = [effect.delay_s for twin in twins for effect in twin.effects if isinstance(effect, FixedDelay)]
        assert np.mean(lags) == pytest.approx(paper_s, abs=3e-6)
        assert 0.5e-6 < np.std(lags) < 3e-6
    twin = draw_twin(4, "A-0000")
    assert parse_twin(twin_text(twin)) == twin
    assert draw_twin(4, "A-0000") == twin != draw_twin(5, "A-0000")
    believed = product_named("fog").believed(twin)["gyro"]
    assert believed["counts"] == {"per_unit": 20_000, "at_zero": 2000}
    assert believed["angle_random_walk"]["value"] == pytest.approx(0.01 / math.sqrt(2000) * 60, rel=1e-9)
    assert 0.005 < believed["angle_random_walk"]["value"] < 0.05
    assert believed["bandwidth_hz"] > 1000


def test_a_query_is_answered_with_the_newest_data_and_a_refused_command_shows() -> None:
    board = LevelBoard(SITE)
    unit = make_unit(1, "U-0001")
    unit.insert(board, 0.0)
    unit.set_supply(5.0, 1.0)
    assert unit.advance(1.4999) == []
    assert unit.next_event_s() == pytest.approx(1.5 + 99 / 2000)  # blocks of 50 ms
    (block,) = unit.advance(1.5)
    assert (block.time_s, block.link, len(block.data)) == (1.5, "rs422", FRAME_BYTES)
    unit.receive("rs422", encode_command(Command.QUERY), 1.5001, None)  # not in query mode
    (block,) = unit.advance(1.5005)
    assert np.frombuffer(block.data, FRAME_DTYPE)["status"] == FrameStatus.COMMAND_REFUSED
    unit.receive("rs422", encode_command(Command.QUERY_MODE), 1.5006, None)
    assert unit.advance(2.0) == []
    assert unit.next_event_s() is None
    unit.receive("rs422", encode_command(Command.QUERY)[:4], 2.0, None)
    unit.receive("rs422", encode_command(Command.QUERY)[4:], 2.0001, None)
    answer_s = 2.0001 + 60e-6 + 120 / 921_600
    assert unit.next_event_s() == pytest.approx(answer_s, abs=1e-12)
    assert unit.advance(answer_s - 1e-6) == []
    (block,) = unit.advance(2.1)
    assert block.time_s == pytest.approx(answer_s, abs=1e-12)
    frame = np.frombuffer(block.data, FRAME_DTYPE)
    assert frame["status"] == FrameStatus.QUERY_MODE
    assert frame["counter"] == 2
    assert abs(int(frame["rate"][0]) - 2000) < 1500
    unit.receive("rs422", encode_command(Command.BROADCAST, 9000), 2.2, None)
    unit.receive("rs422", encode_command(Command.BROADCAST, 1000), 2.3, None)
    assert len(b"".join(output.data for output in unit.advance(2.31))) == 10 * FRAME_BYTES
    assert unit.supply_current_a(2.31) == pytest.approx(0.6)
    unit.set_supply(4.0, 2.31)
    assert unit.advance(3.0) == []


@pytest.mark.parametrize("steps", [1, 13])
def test_a_live_unit_sees_a_live_impact_a_lag_later_in_both_modes(steps: int) -> None:
    stand = live_stand("impact_rig", 3, SITE, "IR-9")
    lag_s = 242.23e-6
    unit = make_unit(1, "U-0001", None, Twin("fog", (FixedDelay("gyro", lag_s),)))
    unit.insert(stand.surroundings, 0.0)
    unit.set_supply(5.0, 0.0)
    assert stand.port.command("STRE ON", 0.0) == "OK"
    assert stand.port.command("ARM", 0.9) == "OK 0.500000000"
    assert stand.port.command("FIRE 1.50013", 1.4).startswith("OK 0.")
    records = b""
    for to_s in np.linspace(1.4, 2.0, steps + 1)[1:].tolist():
        unit.advance(to_s)
        records += stand.port.advance(to_s)
    taken = np.frombuffer(records, RECORD_DTYPE)
    frames = np.frombuffer(taken["frame"].tobytes(), FRAME_DTYPE)
    np.testing.assert_allclose(taken["received_s"], 0.5 + np.arange(len(taken)) / 2000, atol=1e-9)
    shown = int((frames["rate"] > 12_000).argmax())
    # struck at 1.50013 s to 6 us: the frame at 1.5005 is 370 us later, that at 1.5000 earlier
    assert taken["received_s"][shown] == pytest.approx(1.5005, abs=1e-9)
    stamp = int(taken["stamp"][shown])
    assert stamp >> 15 == 1
    assert (stamp & 0x7FFF) * PAPER_STAMPS.resolution_s == pytest.approx(370e-6, abs=7e-6)
    assert taken["stamp"][shown - 1] == 0
    assert stand.port.command("COUNT?", 2.0) == "1"
    # a query whose answer comes less than a lag after the hit does not show it yet, the next one does
    unit.receive("rs422", encode_command(Command.QUERY_MODE), 3.0, None)
    stand.port.command("ARM", 3.0)
    stand.port.command("FIRE 4.0", 3.9)
    rates = []
    unit.advance(3.0)
    for asked_s in (4.0, 4.0003):
        unit.receive("rs422", encode_command(Command.QUERY), asked_s, None)
        (answer,) = unit.advance(asked_s + 0.00021)
        rates.append(int(np.frombuffer(answer.data, FRAME_DTYPE)["rate"][0]))
    assert rates[0] < 12_000 < rates[1]


def test_programmed_impacts_on_a_live_rig_halve_the_bracket_with_every_shot() -> None:
    """The paper's outlook: 5 shots give ±25 µs for certain where random ones take 64 for 99 %."""
    frame_s, instant_error_s = 500e-6, 6e-6
    stand, unit = live_stand("impact_rig", 4, SITE, "IR-9"), make_unit(1, "B-0001")
    unit.insert(stand.surroundings, 0.0)
    unit.set_supply(5.0, 0.0)
    assert stand.port.command("STRE ON", 0.0) == "OK"
    (lag_s,) = (one.delay_s for one in draw_twin(1, "B-0001").effects if isinstance(one, FixedDelay))
    shots = programmed_shots_needed(25e-6, frame_s, instant_error_s)
    assert shots == 5
    delays, now_s, next_frame_s = [], 1.0, 100e-6
    for _ in range(shots):
        assert stand.port.command("ARM", now_s).startswith("OK")
        unit.advance(now_s + 0.6)
        seen_s = np.frombuffer(stand.port.advance(now_s + 0.6), RECORD_DTYPE)["received_s"][-1]
        fire_s = seen_s + 100 * frame_s - next_frame_s
        assert stand.port.command(f"FIRE {fire_s:.9f}", now_s + 0.6).startswith("OK")
        unit.advance(now_s + 0.8)
        records = np.frombuffer(stand.port.advance(now_s + 0.8), RECORD_DTYPE)
        rates = np.frombuffer(records["frame"].tobytes(), FRAME_DTYPE)["rate"].astype(float)
        triggered = int((records["stamp"] >> 15).argmax())
        stamp = int(records["stamp"][detect_impact(rates[: triggered + 20], triggered).frame])
        delays.append((stamp & 0x7FFF) * PAPER_STAMPS.resolution_s)
        known = pure_lag(np.array([*delays, delays[0]]), frame_s)  # two shots are its least
        next_frame_s = next_frame_after_impact_s(known, frame_s)
        now_s += 2.0
    bounds = pure_lag(np.array(delays), frame_s)
    assert bounds.half_width_s <= 25e-6
    assert bounds.lower_s - 0.2e-6 <= lag_s <= bounds.upper_s + 0.2e-6


def test_the_same_unit_gives_the_same_recording() -> None:
    one, other = (recorded("fog", "impact", values=IMPACT) for _ in range(2))
    for name, stream in one.streams.items():
        for column, samples in stream.columns.items():
            np.testing.assert_array_equal(samples, other.streams[name].columns[column])
