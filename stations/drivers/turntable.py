"""A three-axis turntable: a command line over TCP, and its encoder samples on a stream of their own."""

import contextlib
import socket
import threading
from collections.abc import Sequence
from datetime import date
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.bench_description import StandResources
from protocol.errors import Fault, LinkError, LinkTimeoutError
from protocol.instruments import EMULATED_MAKER, StandFacts
from protocol.stand_stream import STAND_SAMPLE_DTYPE
from stations.drivers.clock import BranchClock
from stations.drivers.serial_port import read_available

CONNECT_TIMEOUT_S = 2.0
ANSWER_TIMEOUT_S = 20.0
MAX_ANSWER_BYTES = 4096
MAX_STATUS_POLLS = 100
STATUS_POLL_S = 0.01
MAX_HOME_POLLS = 480
HOME_POLL_S = 0.25
"""Finding the reference takes as long as it takes, within two minutes; the controller does not say."""
POSITION_TOLERANCE_DEG = 0.01
AXES = ("outer", "middle", "inner")


class StandStatus:
    """The controller's answer to STAT?: state, angles (3,) deg, rates (3,) deg/s, temperature °C."""

    def __init__(self, answer: str) -> None:
        self.state, *numbers = answer.split(",")
        values = [float(number) for number in numbers]
        self.angles_deg = values[0:3]
        self.rates_deg_s = values[3:6]
        self.temperature_c = values[6]


class TurntableSession:
    """The connection to a stand's controller, kept between sequences. Any thread may use it.

    `emulated`: its bench is an emulated one.
    """

    def __init__(self, stand: StandResources, *, emulated: bool) -> None:
        self.stand, self.emulated = stand, emulated
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None

    @property
    def where(self) -> str:
        return f"stand {self.stand.stand_id}, {self.stand.command}"

    def ask(self, command: str) -> str:
        """One command and its answer, without the leading OK.

        Raises:
            LinkError: the stand refuses, or cannot be reached.
        """
        with self._lock:
            try:
                answer = self._exchange_on_live_connection(command)
            except OSError as error:
                self._drop()
                kind = LinkTimeoutError if isinstance(error, TimeoutError) else LinkError
                raise kind(
                    f"The stand does not answer to '{command}': {error}.",
                    where=self.where,
                    fault=Fault.STAND,
                    remedy="check the controller's power and network; it is connected to again by itself.",
                ) from None
        if answer.startswith("ERR"):
            raise LinkError(
                f"The stand refuses '{command}': {answer.removeprefix('ERR').strip()}.",
                where=self.where,
                fault=Fault.STAND,
                remedy="clear the cause at the stand (door, reference, limits), then run again.",
            )
        return answer.removeprefix("OK").strip()

    def close(self) -> None:
        """Disconnect; the next command connects again."""
        with self._lock:
            self._drop()

    def _exchange_on_live_connection(self, command: str) -> str:
        """A connection from before a restart of the controller is replaced, once."""
        if self._socket is not None:
            try:
                return self._exchange(command)
            except ConnectionError:
                self._drop()
        return self._exchange(command)

    def _exchange(self, command: str) -> str:
        if self._socket is None:
            host, _, port = self.stand.command.rpartition(":")
            self._socket = socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.settimeout(ANSWER_TIMEOUT_S)
        self._socket.sendall(command.encode() + b"\n")
        received = bytearray()
        while not received.endswith(b"\n"):
            data = self._socket.recv(MAX_ANSWER_BYTES)
            if not data or len(received) > MAX_ANSWER_BYTES:
                raise ConnectionError("the connection was closed" if not data else "the answer has no end")
            received += data
        return received.decode("ascii", "replace").strip()

    def _drop(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None


class LineTurntable:
    """Implements `protocol.instruments.ThreeAxisTurntable` on one branch's clock."""

    def __init__(self, session: TurntableSession, stream_port: Any, clock: BranchClock) -> None:
        self._session = session
        self._port = stream_port
        self._clock = clock
        self._received = bytearray()

    def facts(self) -> StandFacts:
        """Which stand it is and until when it is calibrated. Raises LinkError."""
        identification, due = self._session.ask("*IDN?"), self._session.ask("CAL?")
        try:
            date.fromisoformat(due)
        except ValueError:
            raise self._fault(f"The stand answered '{due}' instead of the date of its calibration") from None
        stand = self._session.stand
        maker = identification.partition(",")[0].strip()
        emulated = self._session.emulated or maker == EMULATED_MAKER
        return StandFacts(stand.stand_id, stand.kind, identification, due, emulated)

    def home(self) -> None:
        """Find the reference; returns when it is found. Raises LinkError."""
        self._session.ask("HOME")
        self._until_ready(MAX_HOME_POLLS, HOME_POLL_S)

    def move_to(self, angles_deg: Sequence[float]) -> None:
        """Move to (outer, middle, inner); returns in position and at rest. Raises LinkError."""
        answer = self._session.ask("MOVE " + ",".join(f"{angle:.6f}" for angle in angles_deg))
        self._let_pass(answer)
        status = self._until_ready()
        errors = [
            (reached - wanted + 180.0) % 360.0 - 180.0
            for reached, wanted in zip(status.angles_deg, angles_deg, strict=True)
        ]
        if max(map(abs, errors)) > POSITION_TOLERANCE_DEG:
            raise self._fault(f"The stand stopped at {status.angles_deg}° instead of {list(angles_deg)}°")

    def rotate(self, axis: str, angle_deg: float, duration_s: float, ramp_s: float) -> None:
        """Turn one axis on a trapezoid of rate; returns when at rest. Raises LinkError."""
        answer = self._session.ask(f"ROT {axis},{angle_deg:.6f},{duration_s:.6f},{ramp_s:.6f}")
        self._let_pass(answer)
        self._until_ready()

    def start_stream(self, rate_hz: float) -> None:
        """Begin encoder samples. Raises LinkError."""
        self._clock.catch_up()
        read_available(self._port, self._session.where)
        self._received.clear()
        self._session.ask(f"STRE ON,{rate_hz:g}")

    def collect(self) -> None:
        """Take in what the stream has brought so far. Raises LinkError."""
        self._received += read_available(self._port, self._session.where)

    def stop_stream(self) -> NDArray[np.void]:
        """The samples since `start_stream`: shape (n,), STAND_SAMPLE_DTYPE. Raises LinkError."""
        self._session.ask("STRE OFF")
        self._clock.catch_up()
        self.collect()
        data = bytes(self._received)
        if len(data) % STAND_SAMPLE_DTYPE.itemsize:
            raise self._fault(f"The stand's stream ends within a sample ({len(data)} bytes)")
        return np.frombuffer(data, STAND_SAMPLE_DTYPE)

    def stop(self) -> None:
        """Come to rest at the acceleration limit; returns at rest. Raises LinkError."""
        self._session.ask("STOP")
        for _ in range(MAX_STATUS_POLLS):
            if self.status().state != "MOVING":
                return
            self._clock.sleep_for(STATUS_POLL_S)
        raise self._fault("The stand does not come to rest")

    def status(self) -> StandStatus:
        """Where the stand is. Raises LinkError."""
        answer = self._session.ask("STAT?")
        try:
            return StandStatus(answer)
        except (ValueError, IndexError):
            raise self._fault(f"The stand's status '{answer}' cannot be read") from None

    def _let_pass(self, answer: str) -> None:
        try:
            duration_s = float(answer)
        except ValueError:
            raise self._fault(f"The stand answered '{answer}' instead of a duration") from None
        self._clock.sleep_for(duration_s)

    def _until_ready(self, polls: int = MAX_STATUS_POLLS, poll_s: float = STATUS_POLL_S) -> StandStatus:
        status = self.status()
        for _ in range(polls):
            if status.state == "READY":
                return status
            if status.state != "MOVING":
                break
            self._clock.sleep_for(poll_s)
            status = self.status()
        raise self._fault(f"The stand did not become ready: its state is {status.state}")

    def _fault(self, what: str) -> LinkError:
        return LinkError(
            f"{what}.",
            where=self._session.where,
            fault=Fault.STAND,
            remedy="look at the stand's controller; home it again.",
        )
