"""Every kind of bench over its ports: the stand answers, the unit is read by what the stand gives it."""

import asyncio
import datetime
import re
from pathlib import Path

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.products.catalogue import PRODUCTS, product_named
from dut_emulator.server.assembly import serve
from dut_emulator.server.bench_kinds import BENCH_KINDS, SOCKET_BOARD, WIRING
from dut_emulator.server.configuration import BenchServerConfiguration
from dut_emulator.server.stands_document import stands_document
from dut_emulator.stands.catalogue import STANDS, live_stand
from dut_emulator.stands.command_port import CommandPort
from dut_emulator.twin import Twin, write_twin
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.mems_ahrs import FrameType as MemsFrameType

STAND_KINDS = sorted(BENCH_KINDS.keys() - {SOCKET_BOARD})
DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "stands.md"
KIND = re.compile(r"`(\w+)`")
COMMAND = re.compile(r"`([A-Z*]+\??)")
STREAM_COLUMNS = {"satellite_simulator": 8, "vehicle_run_stand": 17}
"""Of stands whose stream is not a turntable's."""


def test_benches_take_the_products_that_have_a_profile_for_their_stand() -> None:
    assert set(STAND_KINDS) == set(STANDS)
    mountings = {
        (mounting.stand, product)
        for product in PRODUCTS
        for mounting in product_named(product).profiles.values()
    }
    wired = {(kind, product) for kind in STAND_KINDS for product in BENCH_KINDS[kind].products}
    assert wired == mountings
    assert set(WIRING) == set(PRODUCTS)


def test_the_document_of_the_stands_is_that_of_their_ports() -> None:
    """Every command that a port knows is in it, and the file is what the code writes."""
    text = stands_document()
    assert DOCUMENT.read_text(encoding="utf-8") == text, "python -m dut_emulator.server.stands_document"
    sections = text.split("\n## ")[1:]
    assert (
        sorted(kind for section in sections for kind in KIND.findall(section.splitlines()[0])) == STAND_KINDS
    )
    for section in sections:
        (kind, *_) = KIND.findall(section.splitlines()[0])
        port = live_stand(kind, 1, Site(latitude_deg=40.0, gravity_m_s2=9.8), "S-1").port
        assert isinstance(port, CommandPort)
        rows = [line for line in section.splitlines() if line.startswith("| `")]
        told = {word for row in rows for word in COMMAND.findall(row)}
        known = {*port.COMMANDS, "*IDN?", "CAL?", "STRE"}
        assert known <= told, kind
        assert [fault for fault in port.FAULTS if fault not in (*section.split("`"), "none")] == [], kind


@pytest.mark.parametrize("kind", STAND_KINDS)
def test_a_stand_says_what_it_is_and_until_when_it_is_calibrated(start_bench, kind: str) -> None:
    bench = start_bench(kind=kind)
    participant = bench.participant()
    commands = bench.instrument(bench.description.stand.command)
    assert bench.description.stand.kind == kind
    maker, *_, identity, _ = commands.query("*IDN?").split(",")
    assert (maker, identity) == ("Testloom", bench.description.bench_identity)
    assert datetime.date.fromisoformat(commands.query("CAL?")) > datetime.date(2026, 1, 1)
    assert all(float(limit) >= 0 for limit in commands.query("LIM?").replace("-", "").split(","))
    assert commands.query("FLY").startswith("ERR 1 ")
    if kind != "impact_rig":  # its stream is one record for each frame of a unit
        stream = participant.open(bench.description.stand.stream)
        assert commands.query("STRE ON,50") == "OK"
        participant.wait(participant.now_s + 1.0)
        assert len(stream.received) == 51 * 8 * STREAM_COLUMNS.get(kind, 15)
    assert participant.ask(op="inject", target="stand", fault="on_fire")["ok"] is False
    port = live_stand(kind, 1, Site(latitude_deg=40.0, gravity_m_s2=9.8), "S-1").port
    assert isinstance(port, CommandPort)
    for fault in (*port.FAULTS, "none"):
        assert participant.ask(op="inject", target="stand", fault=fault)["ok"] is True, fault


@pytest.mark.parametrize(
    ("twin", "says"),
    [
        (product_named("rate_gyro_triad").twin(1, "U-0001"), "is one of a rate_gyro_triad, not of a fog"),
        (Twin("fog", (effect_named("acc.bias", bias_si=(0.1, 0.0, 0.0)),)), "a gyro has not"),
    ],
)
def test_a_twin_that_no_unit_here_can_have_is_refused_at_the_start(tmp_path, twin: Twin, says: str) -> None:
    write_twin(twin, tmp_path / "unit.json")
    description = tmp_path / "bench.json"
    configuration = BenchServerConfiguration(
        "b", "impact_rig", tmp_path / "units", description, twin=tmp_path / "unit.json"
    )
    with pytest.raises(TestloomError, match=says):
        asyncio.run(serve(configuration, asyncio.Event()))
    assert not description.exists()


def test_a_stream_that_loses_samples_loses_whole_ones(start_bench) -> None:
    """A satellite simulator's sample has 8 doubles, the first of them its time."""
    bench = start_bench(kind="satellite_simulator")
    participant = bench.participant()
    stream = participant.open(bench.description.stand.stream)
    assert stream is not None
    assert participant.ask(op="inject", target="stand.stream", fault="drop")["ok"]
    assert bench.instrument(bench.description.stand.command).query("STRE ON,50") == "OK"
    began_s = participant.now_s
    participant.wait(began_s + 1.0)
    rows = np.frombuffer(bytes(stream.received), dtype="<f8").reshape(-1, 8)
    np.testing.assert_allclose(rows[:, 0], began_s + np.arange(26) / 25.0, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "product"), [(kind, product) for kind in STAND_KINDS for product in BENCH_KINDS[kind].products]
)
def test_a_unit_runs_on_its_stand(start_bench, kind: str, product: str) -> None:
    """Powered, it draws current and sends something, or an instrument reads something from it."""
    bench = start_bench(kind=kind, product=product)
    participant = bench.participant()
    supply = bench.instrument(bench.description.power_supply)
    assert participant.ask(op="insert", socket="1", serial="U-0001")["ok"]
    link = None
    if bench.description.sockets[0].unit_link is not None:
        link = participant.open(bench.description.sockets[0].unit_link)
    assert supply.command(f"VOLT {WIRING[product].supply_v},(@1)") == '0,"No error"'
    supply.command("CURR 2.0,(@1)")
    supply.command("OUTP ON,(@1)")
    participant.wait(participant.now_s + 3.0)
    assert float(supply.query("MEAS:CURR? (@1)")) > 0.01
    if product == "mems_ahrs":
        answer = participant.exchange(link, MemsFrameType.IDENTIFY)
        assert b"U-0001" in answer.payload
    elif product == "fog":
        assert link is not None
        assert len(link.received) > 1000  # it broadcasts
    elif product == "pulse_imu":
        counter = bench.instrument(bench.description.pulse_counter)
        assert counter.command("CONF:GATE:TIME 1.0") == '0,"No error"'
        assert counter.command("INIT") == '0,"No error"'
        participant.wait(participant.now_s + 1.0)
        counts = np.array(counter.query("FETC?").split(","), dtype=float)
        assert counts.shape == (12,)
        assert counts.sum() > 100  # gravity, if nothing else
    elif product == "rate_gyro_triad":
        meter = participant.open(bench.description.serial_multimeter)
        meter.write(b"SYST:REM\nCONF:VOLT:DC\nROUT:SCAN (@1,2,3)\nREAD?\n")
        participant.wait(participant.now_s + 3.0)
        volts = [float(text) for text in meter.received.decode().split(",")]
        assert len(volts) == 3
        assert all(0 < abs(volt) < 0.1 for volt in volts)  # at rest: the zero-rate outputs
