"""The ecosystem's own clients on a bench: PyVISA, pyserial and python-can, as on hardware."""

import os
import time
import tty
import warnings
from typing import Any

import can
import pytest
import serial

from protocol.can_database import decode_can, encode_can
from protocol.frames import Frame, FrameParser, encode_frame
from protocol.gnc_module import BOOT_DURATION_S, IDENTITY_LAYOUT, SELF_TEST_LAYOUT, FrameType, SelfTest

PATIENCE_S = 15.0


def power_up(bench, participant, socket: str = "1") -> None:
    assert participant.ask(op="insert", socket=socket, serial="GNC-0001")["ok"]
    supply = bench.instrument(bench.description.power_supply)
    for command in (f"VOLT 5.0,(@{socket})", f"CURR 0.8,(@{socket})", f"OUTP ON,(@{socket})"):
        assert supply.command(command) == '0,"No error"'
    participant.wait(participant.now_s + BOOT_DURATION_S + 0.01)


def test_pyvisa_speaks_to_the_instruments(start_bench) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # optional back ends that are not installed announce themselves
        import pyvisa

        manager = pyvisa.ResourceManager("@py")
    bench = start_bench()
    supply: Any = manager.open_resource(
        bench.description.power_supply, read_termination="\n", write_termination="\n", timeout=5000
    )
    try:
        assert supply.query("*IDN?").startswith("Testloom,PS2,TLB-")
        supply.write("VOLT 99,(@1)")
        assert supply.query("*OPC?") == "1"
        assert supply.query("SYST:ERR?").startswith("-222,")
        assert supply.query("OUTP? (@2)") == "0"
    finally:
        supply.close()
        manager.close()


def test_a_can_echo_through_python_can(start_bench) -> None:
    bench = start_bench()
    participant = bench.participant()
    link = participant.open(bench.description.sockets[0].unit_link)
    power_up(bench, participant)
    channel = bench.description.sockets[0].can_channel.split("?")[0].replace("lockstep", "socket")
    adapter: Any = can.Bus(interface="slcan", channel=channel, bitrate=500_000, sleep_after_open=0.0)
    with adapter as bus:
        assert bus.get_version(5.0) == (10, 13)
        participant.exchange(link, FrameType.SELF_TEST, SELF_TEST_LAYOUT.pack(SelfTest.CAN, 0))
        request = encode_can("GNC_TEST_REQUEST", {"pattern": 0xA5A5_0F0F, "counter": 3})
        bus.send(can.Message(arbitration_id=request.identifier, data=request.data, is_extended_id=False))
        assert bus.get_serial_number(5.0) == "TL01"  # the adapter works in order: the frame has been sent
        participant.wait(participant.now_s + 0.05)
        echo = None
        while echo is None:
            message = bus.recv(PATIENCE_S)
            assert message is not None, "no echo"
            decoded = decode_can(message.arbitration_id, bytes(message.data))
            echo = decoded if decoded.name == "GNC_TEST_ECHO" else None
        assert echo.signals == {"inverted_pattern": 0x5A5A_F0F0, "counter": 3, "status": 0}


def test_a_running_clock_over_ptys_and_pyserial(start_bench) -> None:
    """Paced: no waits in lock-step; the unit answers through a pseudo terminal by itself."""
    bench = start_bench(pace=20.0, serial="pty", sockets=1)
    participant = bench.participant()
    assert participant.hello["pace"] == 20.0
    power_up(bench, participant)
    assert participant.now_s >= BOOT_DURATION_S
    with serial.Serial(bench.description.sockets[0].unit_link, 921_600, timeout=PATIENCE_S) as port:
        port.write(encode_frame(FrameType.IDENTIFY, 1, b""))
        parser = FrameParser()
        frames: list[Any] = []
        while not frames:
            data = port.read(1)
            assert data, "no answer"
            frames = parser.feed(data + port.read(port.in_waiting))
        assert isinstance(frames[0], Frame)
        assert IDENTITY_LAYOUT.unpack(frames[0].payload)[1].rstrip(b"\0") == b"GNC-0001"


def test_pace_follows_the_wall_clock(start_bench) -> None:
    bench = start_bench(pace=50.0)
    participant = bench.participant()
    begin, begin_s = time.monotonic(), participant.now_s
    assert participant.wait(begin_s + 5.0)["now_s"] >= begin_s + 5.0
    assert time.monotonic() - begin >= 5.0 / 50.0 - 0.02  # never faster than the pace
    busy = bench.participant("works all the time and holds nobody back")
    assert participant.wait(participant.now_s + 1.0)["ok"]
    assert busy.ask(op="suspend")["now_s"] >= 6.0


@pytest.mark.parametrize("fault", ["corrupt_crc", "drop", "garbage", "stuck"])
def test_link_faults_show_at_the_parser(start_bench, fault) -> None:
    bench = start_bench(sockets=1)
    participant = bench.participant()
    link = participant.open(bench.description.sockets[0].unit_link)
    power_up(bench, participant)
    assert participant.ask(op="inject", target=link.name, fault=fault)["ok"]
    for _ in range(4):
        link.write(encode_frame(FrameType.ECHO, 1, b"hello"))
        participant.wait(participant.now_s + 0.1)
    found, statistics = link.frames(), link.parser.statistics
    match fault:
        case "corrupt_crc":
            assert not found
            assert statistics.crc_errors == 4
        case "drop":
            assert len(found) == 2
        case "garbage":
            assert len(found) == 4
            assert statistics.dropped_bytes == 4 * 12
        case "stuck":
            assert not link.received
    assert participant.ask(op="inject", target=link.name, fault="none")["ok"]
    link.parser.flush()
    assert participant.exchange(link, FrameType.ECHO, b"again").payload[1:] == b"again"


def test_a_raw_pty_passes_every_byte(start_bench) -> None:
    """No echo, no translation of CR or XON: a pty that is not raw would spoil binary frames."""
    bench = start_bench(pace=20.0, serial="pty", sockets=1)
    participant = bench.participant()
    power_up(bench, participant)
    descriptor = os.open(bench.description.sockets[0].unit_link, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(descriptor)
        payload = bytes(range(256))
        os.write(descriptor, encode_frame(FrameType.ECHO, 1, payload))
        parser, frames = FrameParser(), []
        while not frames:
            frames = parser.feed(os.read(descriptor, 4096))
        assert isinstance(frames[0], Frame)
        assert frames[0].payload[1:] == payload
    finally:
        os.close(descriptor)
