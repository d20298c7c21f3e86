"""Byte counts, bench time, arbitration, and benches that go away and come back."""

import socket
import threading
import time

import pytest
import serial

from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import Category
from protocol.bench_control import BenchTime, Insert, Remove, Wait
from protocol.errors import Fault, LinkError
from protocol.outcomes import Outcome
from stations.drivers import arbitration, control_channel
from stations.drivers.arbitration import Arbitration, FairLock
from stations.drivers.clock import BranchClock, WallClock
from stations.drivers.control_channel import ControlChannel
from stations.drivers.serial_port import open_port
from stations.drivers.socket_bench import SocketBench
from stations.interruptions import AbortFlag, SequenceAborted
from stations.sequencing.runner import SequenceRunner
from stations.sequencing.step_registry import bundled_plans

from .conftest import SEED, ServedBench, floor_of, lease_of

HEALTHY = next(
    serial
    for serial in (f"GNC-{number:05d}" for number in range(100))
    if draw_unit(SEED, serial).category is Category.HEALTHY
)


@pytest.fixture
def far_end():
    """A listening socket and the URL of a lockstep port on it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener, f"lockstep://127.0.0.1:{listener.getsockname()[1]}?link=1.rs422"


def test_a_lockstep_port_counts_both_ways_and_reads_up_to_a_count(far_end):
    listener, url = far_end
    port = open_port(url, baud_rate=921_600, where="test")
    connection, _ = listener.accept()
    with connection:
        port.write(b"abc")
        port.write(bytearray(b"de"))
        assert connection.recv(10) in (b"abc", b"abcde")
        assert port.link == "1.rs422"
        assert port.bytes_written == 5
        assert port.in_waiting == 0
        assert port.read(10) == b""
        sender = threading.Timer(0.05, connection.sendall, (b"x" * 100_000,))
        sender.start()
        port.receive_up_to(100_000)
        sender.join()
        assert port.bytes_received == 100_000
        assert port.read(60_000) + port.read(60_000) == b"x" * 100_000
    with pytest.raises(serial.SerialException, match="closed the port"):
        port.receive_up_to(100_001)
    port.close()


@pytest.mark.parametrize("url", ["lockstep://127.0.0.1:1", "lockstep://127.0.0.1?link=a", "lockstep:x"])
def test_a_wrong_port_url_is_refused(url):
    with pytest.raises(LinkError) as refused:
        open_port(url, baud_rate=9600, where="socket 1")
    assert refused.value.fault is Fault.STATION


def test_a_bench_that_does_not_answer_is_given_up(monkeypatch, far_end):
    monkeypatch.setattr(control_channel, "REPLY_GUARD_S", 0.1)
    listener, _ = far_end
    channel = ControlChannel(f"127.0.0.1:{listener.getsockname()[1]}", "test")
    with pytest.raises(LinkError) as silent:
        channel.connect()
    assert silent.value.fault is Fault.STATION
    assert isinstance(silent.value, TimeoutError)


def test_an_abort_ends_a_wait_for_the_bench(far_end):
    """The far end says hello and then nothing, as a bench whose other participants work."""
    listener, _ = far_end
    abort = AbortFlag()

    def answer_hello_only() -> None:
        connection, _ = listener.accept()
        with connection:
            connection.recv(1000)
            connection.sendall(BenchTime(now_s=0.0, pace=0.0).model_dump_json().encode() + b"\n")
            connection.recv(1000)
            abort.request("the operator said so")
            connection.recv(1000)  # until the station hangs up

    bench = threading.Thread(target=answer_hello_only)
    bench.start()
    channel = ControlChannel(f"127.0.0.1:{listener.getsockname()[1]}", "test")
    with pytest.raises(SequenceAborted, match="the operator said so"):
        channel.request(Wait(until_s=1.0), interruption=abort.check)
    bench.join(10)
    assert not bench.is_alive()


class CountedClock(WallClock):
    """Knows whether it takes part in time."""

    def __init__(self) -> None:
        super().__init__()
        self.in_time = True

    def join(self) -> None:
        self.in_time = True

    def leave(self) -> None:
        self.in_time = False


def test_a_shared_instrument_is_given_in_the_order_of_asking():
    lock, order, clocks = FairLock("multimeter"), [], [CountedClock() for _ in range(5)]
    threads = []

    def use(number: int) -> None:
        with lock.held(clocks[number]):
            assert clocks[number].in_time
            order.append(number)

    with lock.held(clocks[0]):
        for number in range(1, 5):
            thread = threading.Thread(target=use, args=(number,))
            thread.start()
            threads.append(thread)
            while len(lock._queue) <= number:
                time.sleep(0)
            assert not clocks[number].in_time
    for thread in threads:
        thread.join(10)
    assert order == [1, 2, 3, 4]
    assert all(clock.in_time for clock in clocks)


def test_waiting_for_a_shared_instrument_is_bounded_and_can_be_aborted(monkeypatch):
    monkeypatch.setattr(arbitration, "MAX_WAIT_WALL_S", 0.1)
    lock, holder, waiter = FairLock("multimeter"), CountedClock(), CountedClock()
    with lock.held(holder):
        with pytest.raises(LinkError) as held, lock.held(waiter):
            pass
        assert held.value.fault is Fault.STATION
        assert waiter.in_time
        abort = AbortFlag()
        abort.request("enough")
        waiter.interruption = abort.check
        with pytest.raises(SequenceAborted), lock.held(waiter):
            pass
    with lock.held(CountedClock()):
        pass  # nobody is left in the queue


def test_time_stands_while_a_branch_works_and_goes_to_the_earliest_wait(tmp_path):
    served = ServedBench(tmp_path)
    bench = SocketBench(served.description, "1", Arbitration(served.description))
    one, other = bench.clock(0), bench.clock(1)
    one.join()
    other.join()
    begun_s = one.now_s()
    seen: list[float] = []

    def sleep(clock: BranchClock, until_s: float) -> None:
        clock.sleep_until(until_s)
        seen.append(clock.now_s() - begun_s)
        clock.leave()

    threads = [
        threading.Thread(target=sleep, args=(one, begun_s + 2.0)),
        threading.Thread(target=sleep, args=(other, begun_s + 1.0)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    bench.close()
    served.close()
    assert seen == pytest.approx([1.0, 2.0])


def test_a_bench_that_comes_back_is_used_again(tmp_path, free_port_base):
    served = ServedBench(tmp_path, port_base=free_port_base)
    floor = floor_of(served, served.description, tmp_path)
    assert floor.run(HEALTHY).outcome is Outcome.PASS
    served.close()
    gone = floor.run(HEALTHY)
    assert (gone.outcome, gone.fault) == (Outcome.ERROR, Fault.STATION)
    again = ServedBench(tmp_path, port_base=free_port_base)
    result = floor.run(HEALTHY)
    floor.runners["1"].close()
    again.close()
    assert result.outcome is Outcome.PASS, result.message


def test_paced_time_gives_the_same_verdict(tmp_path):
    """At pace 1 the wall clock drives the bench: nothing may depend on time standing still."""
    served = ServedBench(tmp_path, pace=1.0)
    floor = floor_of(served, served.description, tmp_path)
    result = floor.run(HEALTHY)
    floor.runners["1"].close()
    served.close()
    assert result.outcome is Outcome.PASS, result.message
    assert result.safe_state


def test_a_bench_as_hardware_offers_it(tmp_path):
    """No control channel: serial devices, the wall clock, and a person who loads the socket."""
    served = ServedBench(tmp_path, pace=1.0, serial="pty")
    hand = ControlChannel(served.description.control or "", "person", observer=True)
    asked: list[str] = []

    def person(prompt: str) -> None:
        asked.append(prompt)
        hand.request(Insert(socket="1", serial=HEALTHY) if len(asked) == 1 else Remove(socket="1"))

    hardware = served.description.model_copy(update={"control": None})
    assert hardware.sockets[0].unit_link.startswith("/dev/")
    runner = SequenceRunner(hardware, "1", Arbitration(hardware), tmp_path, ask_operator=person)
    plan = bundled_plans()["functional"]
    result = runner.run(plan, lease_of(plan, HEALTHY), lambda progress: None, AbortFlag())
    runner.close()
    hand.close()
    served.close()
    assert result.outcome is Outcome.PASS, result.message
    assert result.safe_state
    assert asked == [f"Put unit {HEALTHY} into socket 1.", "Take the unit out of socket 1."]
