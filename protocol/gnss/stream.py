# pyright: strict
"""A receiver's stream, UBX and NMEA mixed: what is whole comes out, what is not is counted and passed over.

After a wrong checksum or length only the first byte is given up, so that a frame inside the noise is found.
"""

from dataclasses import dataclass

from protocol.errors import LinkError
from protocol.gnss import nmea, ubx
from protocol.gnss.nmea import NmeaSentence
from protocol.gnss.ubx import UbxFrame


@dataclass
class StreamStatistics:
    """What has been passed over."""

    dropped_bytes: int = 0
    checksum_errors: int = 0


class GnssStreamParser:
    """Bytes in any pieces → frames and sentences in their order."""

    def __init__(self) -> None:
        self.statistics = StreamStatistics()
        self._waiting = b""

    def feed(self, data: bytes) -> list[UbxFrame | NmeaSentence]:
        """What has become whole with these bytes. At most one longest frame is kept waiting."""
        found: list[UbxFrame | NmeaSentence] = []
        buffer, at = self._waiting + data, 0
        while at < len(buffer):
            start = _next_start(buffer, at)
            self.statistics.dropped_bytes += start - at
            at = start
            taken = self._take(buffer, at, found)
            if taken is None:
                break
            at += taken
        self._waiting = buffer[at:]
        return found

    def _take(self, buffer: bytes, at: int, found: list[UbxFrame | NmeaSentence]) -> int | None:
        """Bytes used from `at` on; None: more are needed."""
        if at >= len(buffer):
            return None
        if buffer[at : at + 1] == b"$":
            return self._take_sentence(buffer, at, found)
        return self._take_frame(buffer, at, found)

    def _take_sentence(self, buffer: bytes, at: int, found: list[UbxFrame | NmeaSentence]) -> int | None:
        end = buffer.find(b"\n", at, at + nmea.MAX_SENTENCE_BYTES)
        if end < 0:
            return None if len(buffer) - at < nmea.MAX_SENTENCE_BYTES else self._give_up()
        try:
            found.append(nmea.parse_sentence(buffer[at : end + 1]))
        except LinkError:
            self.statistics.checksum_errors += 1
            return self._give_up()
        return end + 1 - at

    def _take_frame(self, buffer: bytes, at: int, found: list[UbxFrame | NmeaSentence]) -> int | None:
        head = buffer[at : at + ubx.HEAD.size]
        if len(head) < ubx.HEAD.size:
            return None if ubx.SYNC.startswith(head[:2]) else self._give_up()
        _, group, number, length = ubx.HEAD.unpack(head)
        if length > ubx.MAX_PAYLOAD_BYTES:
            return self._give_up()
        end = at + ubx.HEAD.size + length
        if len(buffer) < end + ubx.CHECKSUM_BYTES:
            return None
        if buffer[end : end + ubx.CHECKSUM_BYTES] != ubx.checksum(buffer[at + 2 : end]):
            self.statistics.checksum_errors += 1
            return self._give_up()
        found.append(UbxFrame((group, number), buffer[at + ubx.HEAD.size : end]))
        return end + ubx.CHECKSUM_BYTES - at

    def _give_up(self) -> int:
        self.statistics.dropped_bytes += 1
        return 1


def _next_start(buffer: bytes, at: int) -> int:
    """Where the next frame or sentence may begin; the end if nowhere."""
    starts = [place for place in (buffer.find(b"$", at), buffer.find(ubx.SYNC, at)) if place >= 0]
    if buffer.endswith(ubx.SYNC[:1]):
        starts.append(len(buffer) - 1)
    return min(starts, default=len(buffer))
