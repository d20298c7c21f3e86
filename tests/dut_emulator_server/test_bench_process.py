"""A bench as a process: command line, errors for people, its end; and units that move between benches."""

import asyncio
import json
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dut_emulator.server.assembly import serve
from dut_emulator.server.configuration import BenchServerConfiguration
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, TestloomError
from protocol.gnc_module import BOOT_DURATION_S, COEFFICIENTS_LAYOUT, FrameType, ReplyStatus, Sensor

ROOT = Path(__file__).parents[2]
COMMAND = (
    sys.executable,
    "-c",
    "import sys; from cli.main import main; sys.exit(main(sys.argv[1:]))",
    "bench",
)


def start(*options: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [*COMMAND, *options], cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )


def test_a_bench_says_that_it_is_up_and_ends_cleanly_on_sigterm(tmp_path: Path) -> None:
    description = tmp_path / "benches" / "b.json"
    description.parent.mkdir()
    description.write_text("left behind by a bench that was killed")
    with start(
        "--name", "b", "--units-dir", str(tmp_path / "u"), "--description", str(description)
    ) as process:
        assert process.stderr is not None
        entry = json.loads(process.stderr.readline())
        assert (entry["event"], entry["bench"]) == ("bench is up", "b")
        described = BenchDescription.model_validate_json(description.read_text())
        assert described.control == entry["control"]
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
    assert not description.exists()


def test_the_command_line_says_what_is_wrong_without_a_traceback(tmp_path: Path) -> None:
    options = ("--name", "b", "--units-dir", str(tmp_path), "--description", str(tmp_path / "b.json"))
    with start(*options, "--kind", "centrifuge") as process:
        _, text = process.communicate(timeout=30)
        assert process.returncode == 1
    assert "centrifuge" in text
    assert "three_axis_turntable" in text
    assert "Traceback" not in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kind": "centrifuge"}, "socket_board"),
        ({"serial": "carrier pigeon"}, "pty"),
        ({"serial": "pty"}, "counts no bytes"),
        ({"sockets": 0}, "1 to 16"),
        ({"kind": "three_axis_turntable", "sockets": 2}, "1 to 1"),
        ({"pace": -1.0}, "lock-step"),
        ({"pace": float("nan")}, "lock-step"),
        ({"latitude_deg": 91.0}, "degrees"),
        ({"gravity_m_s2": 1.6}, "9.7 to 9.9"),
        ({"port_base": 80}, "free ports"),
        ({"port_base": 65_535}, "free ports"),
        ({"name": "a/b"}, "plain word"),
        ({"seed": -1}, "a number"),
    ],
)
def test_what_cannot_be_a_bench(tmp_path: Path, options, words) -> None:
    settings: dict[str, Any] = {
        "name": "b",
        "kind": "socket_board",
        "units_dir": tmp_path,
        "description": tmp_path / "b",
        **options,
    }
    with pytest.raises(TestloomError, match="cannot have") as caught:
        BenchServerConfiguration(**settings)
    assert words in caught.value.remedy
    assert caught.value.fault is Fault.OPERATOR


def test_a_port_in_use_is_named(start_bench, free_port_base: int, tmp_path: Path) -> None:
    start_bench(port_base=free_port_base, name="first")
    with pytest.raises(TestloomError, match=f"port {free_port_base}") as caught:
        start_bench(port_base=free_port_base, name="second")
    assert "--port-base" in caught.value.remedy
    assert not (tmp_path / "second.json").exists()


@pytest.mark.parametrize("option", ["units_dir", "description"])
def test_a_directory_that_cannot_be_one_is_named(tmp_path: Path, option: str) -> None:
    file = tmp_path / "file"
    file.write_text("")
    settings: dict[str, Any] = {
        "units_dir": tmp_path / "u",
        "description": tmp_path / "b.json",
        option: file / "below",
    }
    configuration = BenchServerConfiguration(name="b", kind="socket_board", **settings)

    async def run() -> None:
        await serve(configuration, asyncio.Event())

    with pytest.raises(TestloomError) as caught:
        asyncio.run(run())
    assert str(file) in caught.value.where
    assert caught.value.fault is Fault.OPERATOR


def boot(bench, participant):
    supply = bench.instrument(bench.description.power_supply)
    for command in ("VOLT 5,(@1)", "CURR 1,(@1)", "OUTP ON,(@1)"):
        assert supply.command(command) == '0,"No error"'
    participant.wait(participant.now_s + BOOT_DURATION_S + 0.1)


def test_coefficients_travel_with_the_unit_to_the_next_bench(start_bench, tmp_path: Path) -> None:
    """Written on one bench, there on the next; durable before the station sees the unit's answer."""
    written = COEFFICIENTS_LAYOUT.pack(Sensor.GYRO, *(1.01, 0, 0, 0, 0.99, 0, 0, 0, 1.0), *(1e-3, 0, -1e-3))
    first, second = start_bench(), start_bench(kind="three_axis_turntable")
    one = first.participant()
    link = one.open(first.description.sockets[0].unit_link)
    assert one.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    boot(first, one)
    assert one.exchange(link, FrameType.WRITE_COEFFICIENTS, written).payload[0] == ReplyStatus.DONE
    assert "1.01" in (tmp_path / "units" / "GNC-0001.json").read_text()
    assert one.ask(op="remove", socket="1")["ok"]

    other = second.participant()
    link = other.open(second.description.sockets[0].unit_link)
    assert other.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    boot(second, other)
    reply = other.exchange(link, FrameType.READ_COEFFICIENTS, struct.pack("<B", Sensor.GYRO))
    assert reply.payload == bytes((ReplyStatus.DONE,)) + written
    assert not list((tmp_path / "units").glob(".*"))


def test_a_damaged_flash_is_refused_by_name(start_bench, tmp_path: Path) -> None:
    bench = start_bench()
    hand = bench.participant("hand", observer=True)
    for damaged in ('{"format": ', "[]", '{"format": "testloom-flash/1", "power_cycles": 1}'):
        (tmp_path / "units" / "GNC-0001.json").write_text(damaged)
        reply = hand.ask(op="insert", socket="1", serial="GNC-0001")
        assert "flash of unit GNC-0001 cannot be read" in reply["what"]
    assert hand.ask(op="insert", socket="1", serial="GNC-0002")["ok"]
