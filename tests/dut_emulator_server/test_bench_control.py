"""The control channel: whose time passes when, who holds whom back, and what is refused."""

import json
import socket
import struct

import pytest

from protocol.bench_control import MAX_CONTROL_LINE_BYTES
from protocol.gnc_module import BOOT_DURATION_S, FrameType


def test_side_by_side_time_jumps_to_the_earliest_moment(start_bench) -> None:
    bench = start_bench()
    one, two = bench.participant("one"), bench.participant("two")
    one.start_wait(5.0)
    two.start_wait(2.0)
    assert two.receive()["now_s"] == 2.0
    two.start_wait(9.0)
    assert one.receive()["now_s"] == 5.0
    one.close()
    assert two.receive()["now_s"] == 9.0


def test_whoever_dies_or_is_suspended_holds_nobody_back(start_bench) -> None:
    bench = start_bench()
    one, dying, away = (bench.participant(name) for name in ("one", "dying", "away"))
    bench.participant("watcher", observer=True)
    one.start_wait(1.0)
    assert away.ask(op="suspend")["ok"]
    dying.close()
    assert one.receive()["now_s"] == 1.0
    assert away.ask(op="resume")["now_s"] == 1.0
    one.start_wait(2.0)
    away.start_wait(1.5)
    assert away.receive()["now_s"] == 1.5
    away.close()
    assert one.receive()["now_s"] == 2.0


def test_a_death_in_mid_wait_and_a_new_connection(start_bench) -> None:
    bench = start_bench()
    one, dying = bench.participant("one"), bench.participant("dying")
    dying.start_wait(0.5)
    dying.close()
    assert one.wait(1.0)["now_s"] == 1.0
    again = bench.participant("dying")
    assert again.now_s == 1.0
    one.start_wait(3.0)
    assert again.wait(2.0)["now_s"] == 2.0


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"not json", "no control request"),
        (b'{"op": "explode"}', "no control request"),
        (b'{"op": "wait", "until_s": 1.0}', "before 'hello'|not at work"),
        (b'{"op": "insert", "socket": "1", "serial": "X"}', "before 'hello'"),
        (b'{"op": "wait", "until_s": Infinity}', "no control request"),
        (b'{"op": "hello"}', "participant"),
    ],
)
def test_nonsense_is_refused_and_the_connection_lives(start_bench, line, reason) -> None:
    bench = start_bench()
    host, port = bench.description.control.split(":")
    with (
        socket.create_connection((host, int(port)), timeout=10) as connection,
        connection.makefile("rb") as file,
    ):
        connection.sendall(line + b"\n")
        reply = json.loads(file.readline())
        assert reply["ok"] is False
        assert any(word in reply["what"] for word in reason.split("|")), reply
        connection.sendall(b'{"op": "hello", "participant": "x"}\n')
        assert json.loads(file.readline())["ok"] is True


def test_an_endless_line_ends_its_own_connection_only(start_bench) -> None:
    bench = start_bench()
    other = bench.participant()
    host, port = bench.description.control.split(":")
    with (
        socket.create_connection((host, int(port)), timeout=10) as connection,
        connection.makefile("rb") as file,
    ):
        connection.sendall(b"x" * (MAX_CONTROL_LINE_BYTES + 1))
        assert "longer than" in json.loads(file.readline())["what"]
        assert file.readline() == b""
    assert other.wait(1.0)["ok"]


def test_connections_are_bounded_and_become_free_again(start_bench, monkeypatch) -> None:
    monkeypatch.setattr("dut_emulator.server.listening.MAX_CONNECTIONS", 2)
    bench = start_bench()
    one, two = bench.participant("one"), bench.participant("two")
    host, port = bench.description.control.split(":")
    with socket.create_connection((host, int(port)), timeout=10) as third:
        assert third.recv(1) == b""
    two.close()
    assert one.wait(1.0)["ok"]  # by now the bench knows that it has gone
    assert bench.participant("again").wait(1.0)["ok"]


def test_a_hand_that_loads_units_is_told_what_it_cannot_do(start_bench) -> None:
    bench = start_bench()
    hand = bench.participant("hand", observer=True)
    assert hand.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    assert "holds unit GNC-0001" in hand.ask(op="insert", socket="1", serial="GNC-0002")["what"]
    assert "no socket '9'" in hand.ask(op="insert", socket="9", serial="GNC-0002")["what"]
    assert "no serial number" in hand.ask(op="insert", socket="2", serial="../etc/passwd")["what"]
    assert hand.ask(op="remove", socket="1")["ok"]
    assert hand.ask(op="remove", socket="1")["ok"]  # empty already: nothing to do
    assert "there is no 'x'" in hand.ask(op="inject", target="x", fault="stuck")["what"]
    assert "cannot have" in hand.ask(op="inject", target="1.rs422", fault="door_open")["what"]


def test_what_a_wait_cannot_be(start_bench) -> None:
    participant = start_bench().participant()
    assert "no link 'nowhere'" in participant.ask(op="wait", until_s=1.0, written={"nowhere": 1})["what"]
    assert "longer than" in participant.ask(op="wait", until_s=1e12)["what"]
    assert "already" in participant.ask(op="hello", participant="again")["what"]
    assert participant.wait(-5.0)["now_s"] == 0.0  # a moment that has come already


def test_time_waits_for_bytes_that_are_on_their_way(start_bench) -> None:
    """A wait says more bytes than have been sent; it begins when the rest comes."""
    bench = start_bench()
    participant = bench.participant()
    link = participant.open(bench.description.sockets[0].unit_link)
    participant.send(op="wait", until_s=1.0, written={link.name: 4})
    participant.connection.settimeout(0.05)
    with pytest.raises(TimeoutError):
        participant.connection.recv(1, socket.MSG_PEEK)
    participant.connection.settimeout(20)
    link.connection.sendall(b"1234")
    link.written = 4
    assert participant.receive()["now_s"] == 1.0


def test_bytes_that_never_come_are_named(start_bench, monkeypatch) -> None:
    monkeypatch.setattr("dut_emulator.server.bench_server.ARRIVAL_TIMEOUT_S", 0.05)
    bench = start_bench()
    participant, other = bench.participant(), bench.participant("other")
    link = participant.open(bench.description.sockets[0].unit_link)
    participant.send(op="wait", until_s=1.0, written={link.name: 4})
    assert "1.rs422: 0 of 4" in participant.receive()["what"]
    other.start_wait(2.0)
    assert participant.wait(1.0)["now_s"] == 1.0


def test_a_link_counts_from_when_it_was_opened(start_bench) -> None:
    bench = start_bench()
    participant = bench.participant()
    url = bench.description.sockets[0].unit_link
    for _ in range(3):
        link = participant.open(url)
        link.write(b"x" * 100)
        assert participant.wait(participant.now_s + 0.1)["handed_over"][link.name] == 0
        link.connection.close()


def test_a_reader_that_does_not_read_is_told_so_and_memory_is_bounded(start_bench, monkeypatch) -> None:
    monkeypatch.setattr("dut_emulator.server.links.ByteLink.max_buffered_bytes", 200_000)
    bench = start_bench()
    participant, other = bench.participant(), bench.participant("other")
    assert participant.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    supply = bench.instrument(bench.description.power_supply)
    for command in ("VOLT 5,(@1)", "CURR 1,(@1)", "OUTP ON,(@1)"):
        assert supply.command(command) == '0,"No error"'
    assert other.ask(op="suspend")["ok"]
    link = participant.open(bench.description.sockets[0].unit_link)
    participant.wait(BOOT_DURATION_S + 0.1)
    assert participant.exchange(link, FrameType.START_STREAM, struct.pack("<HB", 400, 0)).payload[0] == 0
    participant.links.clear()  # from here on nobody reads
    reply = participant.ask(op="wait", until_s=3600.0, written={link.name: link.written})
    assert reply["ok"] is False
    assert "nobody reads 1.rs422" in reply["what"]
    assert participant.ask(op="suspend")["now_s"] < 3600.0
    assert other.ask(op="resume")["ok"]  # the others go on
    assert other.wait(other.now_s + 1.0)["ok"]
    link.connection.close()
