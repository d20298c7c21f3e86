"""A stream on CAN, as a station's adapter tells it: a line for each frame, and nothing while closed."""

import re

from dut_emulator.interfaces import LinkOutput
from dut_emulator.products.gnc_module import make_unit
from dut_emulator.server.bench_model import SocketModel
from dut_emulator.stands.level_board import LevelBoard
from protocol.bench_description import Site
from protocol.can_database import GNC_RATE, GNC_SPECIFIC_FORCE, decode_can
from protocol.frames import encode_frame
from protocol.gnc_module import START_STREAM_LAYOUT, FrameType


def test_a_burst_is_its_frames_one_by_one() -> None:
    burst = LinkOutput(0.5, "can", bytes(range(24)), burst_ids=(0x110, 0x111))
    assert burst.frames() == [
        LinkOutput(0.5, "can", bytes(range(8)), 0x110),
        LinkOutput(0.5, "can", bytes(range(8, 16)), 0x111),
        LinkOutput(0.5, "can", bytes(range(16, 24)), 0x110),
    ]
    single = LinkOutput(0.5, "rs422", b"abc")
    assert single.frames() == [single]


def test_a_stream_comes_line_by_line_where_the_adapter_is_open() -> None:
    socket = SocketModel("A", LevelBoard(Site(latitude_deg=34.2, gravity_m_s2=9.797)))
    socket.insert(make_unit(1, "GM-0001"), "GM-0001", 0.0)
    socket.set_supply(5.0, 0.0)
    socket.advance(2.0)
    socket.receive_rs422(encode_frame(FrameType.START_STREAM, 1, START_STREAM_LAYOUT.pack(200, 0)), 2.0)
    assert {link for link, _ in socket.advance(3.1)} == {"A.rs422"}
    socket.receive_can(b"S6\rO\r", 3.1)
    heard = b"".join(data for link, data in socket.advance(4.1) if link == "A.can").decode()
    lines = re.findall(r"t([0-9A-F]{3})8([0-9A-F]{16})\r", heard)
    assert "".join(f"t{number}8{data}\r" for number, data in lines) == heard
    messages = [decode_can(int(number, 16), bytes.fromhex(data)) for number, data in lines]
    streamed = [m for m in messages if m.name in (GNC_RATE, GNC_SPECIFIC_FORCE)]
    assert [m.name for m in streamed] == [GNC_RATE, GNC_SPECIFIC_FORCE] * (len(streamed) // 2)
    counters = [int(m.signals["rate_counter"]) for m in streamed[::2]]
    assert counters == list(range(200, 400, 2))  # the four blocks of 50 samples that were complete meanwhile
