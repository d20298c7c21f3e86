"""The slcan adapter by itself, against the Lawicel manual's examples and against nonsense."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dut_emulator.server.slcan import DONE, MAX_COMMAND_BYTES, REFUSED, SlcanAdapter


def opened() -> SlcanAdapter:
    adapter = SlcanAdapter()
    assert adapter.feed(b"S6\rO\r") == (DONE * 2, [])
    return adapter


def test_the_manuals_examples() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"\r\r\r") == (b"\r\r\r", [])
    assert adapter.feed(b"V\rN\r")[0] == b"V1013\rNTL01\r"
    assert adapter.feed(b"t10021133\r") == (REFUSED, [])  # not open
    assert adapter.feed(b"O\r") == (REFUSED, [])  # no bit rate
    assert adapter.feed(b"S6\rO\rS4\r") == (DONE + DONE + REFUSED, [])  # open: no other bit rate
    assert adapter.feed(b"F\r") == (b"F00\r", [])
    answers, frames = adapter.feed(b"t10021133\r")
    assert answers == b"z\r"
    assert [(frame.identifier, frame.data) for frame in frames] == [(0x100, b"\x11\x33")]
    assert adapter.feed(b"T0000010021133\rr1008\r") == (b"Z\rz\r", [])  # nobody on this bus listens to these
    assert adapter.frame_line(0x121, b"\xab\xcd") == b"t1212ABCD\r"
    assert adapter.frame_line(0x18FF0000, b"") == b"T18FF00000\r"
    assert adapter.feed(b"C\r") == (DONE, [])
    assert adapter.frame_line(0x121, b"\xab") == b""


def test_at_another_bit_rate_nobody_understands_anybody() -> None:
    adapter = SlcanAdapter()
    adapter.feed(b"S5\rO\r")
    assert adapter.feed(b"t1002113\r")[1] == []
    assert adapter.frame_line(0x121, b"\xab") == b""


def test_listening_only_sends_nothing() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"S6\rL\rt10021133\r") == (DONE + DONE + REFUSED, [])
    assert adapter.frame_line(0x121, b"\xab") == b"t1211AB\r"


@pytest.mark.parametrize(
    "command", [b"t1009112233445566778899", b"t10021", b"t1002GG11", b"tFFF0", b"x", b"S", b"OO"]
)
def test_what_is_refused(command: bytes) -> None:
    assert opened().feed(command + b"\r") == (REFUSED, [])


@given(st.lists(st.binary(max_size=200), max_size=8))
def test_nonsense_is_bounded_and_an_empty_command_finds_the_way_back(pieces: list[bytes]) -> None:
    adapter = opened()
    for piece in pieces:
        adapter.feed(piece)
    adapter.feed(b"\r")
    assert adapter.feed(b"V\r")[0] == b"V1013\r"
    assert adapter.feed(b"x" * (MAX_COMMAND_BYTES + 1))[0] == REFUSED


@given(
    st.binary(max_size=60).map(lambda b: b"t1002AABB\rV\r" + b.replace(b"\r", b"") + b"\rt10100\r"), st.data()
)
def test_answers_do_not_depend_on_how_bytes_are_cut(stream: bytes, data: st.DataObject) -> None:
    whole = opened().feed(stream)
    cut = data.draw(st.integers(0, len(stream)))
    adapter = opened()
    first, second = adapter.feed(stream[:cut]), adapter.feed(stream[cut:])
    assert (first[0] + second[0], first[1] + second[1]) == whole
