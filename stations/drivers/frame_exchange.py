"""One RS-422 link shared by the branches of a sequence: replies sorted into mailboxes, streams collected.

Whoever waits reads for everybody: a reply goes into the mailbox of its (type, sequence), and its
owner finds it there. A reply that nobody expects (a duplicate, a late one) is counted and dropped.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from serial import SerialException

from protocol.frames import Frame, FrameBlock, FrameParser, FrameStatistics, encode_frame
from protocol.gnc_module import REPLY_BIT, SAMPLE_DTYPE, FrameType
from stations.drivers.serial_port import lost_port, read_available

MAX_STREAM_SAMPLES = 4_000_000
"""More than two hours at the highest rate; beyond it the stream was never stopped."""


@dataclass(frozen=True)
class LinkHealth:
    """What the link did since the sequence began."""

    frames: FrameStatistics
    bytes_received: int
    unexpected_replies: int
    damaged_samples: int


class FrameExchange:
    """Sends commands and keeps what comes, for one sequence. Any thread may use it."""

    def __init__(self, port: Any, where: str) -> None:
        self.port = port
        self.where = where
        self._lock = threading.Lock()
        self._parser = FrameParser()
        self._sequence = 0
        self._mailboxes: dict[tuple[int, int], dict[int, bytes]] = {}
        self._samples: list[NDArray[np.void]] = []
        self._sample_count = 0
        self._bytes = 0
        self._unexpected = 0
        self._damaged_samples = 0

    def post(self, frame_type: FrameType, payload: bytes) -> int:
        """Send a command and open a mailbox for its replies; the sequence that names it.

        Raises:
            LinkError: the port is gone.
        """
        with self._lock:
            self._sequence = self._free_sequence(frame_type)
            self._mailboxes[frame_type | REPLY_BIT, self._sequence] = {}
            try:
                self.port.write(encode_frame(frame_type, self._sequence, payload))
            except (SerialException, OSError) as error:
                raise lost_port(error, self.where) from None
            return self._sequence

    def replies(self, frame_type: FrameType, sequence: int) -> dict[int, bytes]:
        """What has come to a command so far: status → payload after the status byte."""
        with self._lock:
            return dict(self._mailboxes.get((frame_type | REPLY_BIT, sequence), {}))

    def close_mailboxes(self, frame_type: FrameType, sequences: Iterable[int]) -> None:
        """Expect nothing more to these commands."""
        with self._lock:
            for sequence in sequences:
                self._mailboxes.pop((frame_type | REPLY_BIT, sequence), None)

    def collect(self, *, line_is_silent: bool = False) -> None:
        """Sort everything that has come.

        Args:
            line_is_silent: nothing has come for longer than a frame takes: give an incomplete frame up.

        Raises:
            LinkError: the port is gone.
        """
        with self._lock:
            data = read_available(self.port, self.where)
            self._bytes += len(data)
            found = self._parser.feed(data) if data else []
            if line_is_silent and self._parser.pending_bytes:
                found += self._parser.flush()
            for item in found:
                self._sort(item)

    def begin_samples(self) -> None:
        """Forget samples of an earlier stream."""
        with self._lock:
            self._samples.clear()
            self._sample_count = 0

    def take_samples(self) -> NDArray[np.void]:
        """All samples since `begin_samples`, in order: shape (n,), SAMPLE_DTYPE."""
        with self._lock:
            samples, self._samples = self._samples, []
            self._sample_count = 0
        return np.concatenate(samples) if samples else np.empty(0, SAMPLE_DTYPE)

    @property
    def health(self) -> LinkHealth:
        """What the link did so far."""
        with self._lock:
            return LinkHealth(self._parser.statistics, self._bytes, self._unexpected, self._damaged_samples)

    def _free_sequence(self, frame_type: FrameType) -> int:
        for step in range(1, 257):
            sequence = (self._sequence + step) % 256
            if (frame_type | REPLY_BIT, sequence) not in self._mailboxes:
                return sequence
        self._mailboxes.clear()  # 256 commands of one type are never open at once: these were forgotten
        return (self._sequence + 1) % 256

    def _sort(self, item: Frame | FrameBlock) -> None:
        if item.type == FrameType.STREAM_SAMPLE:
            self._keep_samples(item)
            return
        for frame in item.frames() if isinstance(item, FrameBlock) else (item,):
            mailbox = self._mailboxes.get((frame.type, frame.sequence))
            if mailbox is None or not frame.payload or frame.payload[0] in mailbox:
                self._unexpected += 1
            else:
                mailbox[frame.payload[0]] = frame.payload[1:]

    def _keep_samples(self, item: Frame | FrameBlock) -> None:
        payload = item.payloads if isinstance(item, FrameBlock) else np.frombuffer(item.payload, np.uint8)
        if payload.shape[-1] != SAMPLE_DTYPE.itemsize or self._sample_count >= MAX_STREAM_SAMPLES:
            self._damaged_samples += len(payload) if isinstance(item, FrameBlock) else 1
            return
        samples = payload.reshape(-1).view(SAMPLE_DTYPE)
        self._samples.append(samples)
        self._sample_count += len(samples)
