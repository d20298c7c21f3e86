"""Frames parsed, samples written and read: on one core, beside the plain way in the same run.

The plain way with MCAP is what most programs do: one `write_message` of mcap-protobuf-support for each
sample, and its decoder on the way back. It gets fewer samples, since it takes that much longer.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray

from protocol.adapters.mcap_form import read_mcap, write_mcap
from protocol.adapters.sample_messages import SampleLayout
from protocol.frames import FrameParser, encode_equal_frames
from protocol.gnc_module import SAMPLE_DTYPE, FrameType
from protocol.recording_document import types_of
from protocol.recordings import Recording, Stream

REPETITIONS = 3
FRAMES = 400_000
MIXED_FRAMES = 20_000
READ_BYTES = 65_536
"""What a station takes from a socket at once."""
SAMPLES = 1_000_000
PLAIN_SAMPLES = 20_000
RATE_HZ = 200

GOAL_FRAMES_MB_S = 50.0
GOAL_WRITTEN_PER_S = 500_000.0
GOAL_READ_PER_S = 1_000_000.0

T = TypeVar("T")


def run() -> list[dict[str, Any]]:
    """The figures of this module."""
    return [*_frames(), *_recordings()]


def _frames() -> list[dict[str, Any]]:
    rng = np.random.default_rng(1)
    payloads = rng.integers(0, 256, (FRAMES, SAMPLE_DTYPE.itemsize), dtype=np.uint8)
    stream = encode_equal_frames(FrameType.STREAM_SAMPLE, 0, payloads)
    pieces = [stream[at : at + READ_BYTES] for at in range(0, len(stream), READ_BYTES)]
    elapsed_s, parser = _best(lambda: _parse(pieces))
    assert parser.statistics.frames == FRAMES
    # frames that change their type each time never make a block: the price of one object per frame
    singles = b"".join(
        encode_equal_frames(number % 2, 0, payloads[number : number + 1]) for number in range(MIXED_FRAMES)
    )
    single_s, parser = _best(lambda: _parse([singles]))
    assert parser.statistics.frames == MIXED_FRAMES
    beside = (
        f"frame by frame: {len(singles) / single_s / 1e6:.1f} MB/s, {MIXED_FRAMES / single_s:,.0f} frames/s"
    )
    return [
        _figure("RS-422 frames parsed", len(stream) / elapsed_s / 1e6, "MB/s", GOAL_FRAMES_MB_S, beside),
        _figure("RS-422 frames parsed, number", FRAMES / elapsed_s, "frames/s", None, beside),
    ]


def _parse(pieces: list[bytes]) -> FrameParser:
    parser = FrameParser()
    for piece in pieces:
        parser.feed(piece)
    return parser


def _recordings() -> list[dict[str, Any]]:
    recording, plain = _recording(SAMPLES), _recording(PLAIN_SAMPLES)
    with tempfile.TemporaryDirectory(prefix="testloom-bench-") as folder:
        ours, theirs = Path(folder) / "ours.mcap", Path(folder) / "plain.mcap"
        written_s, reference = _best(lambda: write_mcap(recording, ours))
        read_s, back = _best(lambda: read_mcap(ours))
        plain_written_s, _ = _best(lambda: _write_plain(plain.streams["dut"], theirs))
        plain_read_s, count = _best(lambda: _read_plain(theirs))
    assert reference.sample_count == len(back.streams["dut"]) == SAMPLES
    assert count == PLAIN_SAMPLES
    return [
        _against_plain("MCAP samples written", SAMPLES / written_s, GOAL_WRITTEN_PER_S, plain_written_s),
        _against_plain("MCAP samples read", SAMPLES / read_s, GOAL_READ_PER_S, plain_read_s),
    ]


def _against_plain(figure: str, per_s: float, goal: float, plain_s: float) -> dict[str, Any]:
    plain_per_s = PLAIN_SAMPLES / plain_s
    beside = f"mcap-protobuf per sample: {plain_per_s:,.0f}/s (ours × {per_s / plain_per_s:.0f})"
    return _figure(figure, per_s, "samples/s", goal, beside)


def _figure(figure: str, value: float, unit: str, goal: float | None, beside: str) -> dict[str, Any]:
    met = None if goal is None else bool(value >= goal)
    return {"figure": figure, "value": value, "unit": unit, "goal": goal, "met": met, "compared_with": beside}


def _recording(samples: int) -> Recording:
    """Time, six axes, temperature and counter, quantised as the unit sends them."""
    rng = np.random.default_rng(2)
    time_s = np.arange(samples) / RATE_HZ
    units = {"t": "s"}
    columns: dict[str, NDArray[Any]] = {"t": time_s}
    for sensor, unit, quantum, amplitude in (("gyro", "deg/s", 0.0025, 100.0), ("acc", "g", 0.0005, 1.0)):
        for axis, frequency_hz in zip("xyz", (0.1, 0.23, 0.31), strict=True):
            motion = amplitude * np.sin(2 * np.pi * frequency_hz * time_s)
            counts = np.rint(motion / quantum + 4 * rng.standard_normal(samples))
            columns[f"{sensor}_{axis}"], units[f"{sensor}_{axis}"] = counts * quantum, unit
    columns["temp"], units["temp"] = np.round(25 + 0.1 * rng.standard_normal(samples), 2), "degC"
    columns["counter"], units["counter"] = np.arange(samples, dtype=np.uint32), "1"
    stream = Stream("dut", "dut", "t", units, columns)
    return Recording("bench", {"serial": "U-1"}, {"profile": "bench"}, {"dut": stream})


def _write_plain(stream: Stream, path: Path) -> None:
    """Each sample as a message object of its own, by the same schema."""
    layout = SampleLayout(stream.name, 1, types_of(stream), stream.units)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(descriptor_pb2.FileDescriptorSet.FromString(layout.schema()).file[0])
    message_class = message_factory.GetMessageClass(pool.FindMessageTypeByName(layout.schema_name))
    samples = zip(*(stream.columns[column].tolist() for column in stream.units), strict=True)
    names = list(stream.units)
    with path.open("wb") as file, Writer(file) as writer:
        for values in samples:
            log_time_ns = round(values[0] * 1e9)
            writer.write_message("/dut", message_class(**dict(zip(names, values, strict=True))), log_time_ns)


def _read_plain(path: Path) -> int:
    """Each message decoded, its values taken out."""
    count = 0
    values: list[float] = []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages():
            values.append(message.gyro_x)
            count += 1
    return count


def _best(action: Callable[[], T]) -> tuple[float, T]:
    """The shortest of a few times (the one least disturbed by others), and the result."""
    return min((_timed(action) for _ in range(REPETITIONS)), key=lambda run: run[0])


def _timed(action: Callable[[], T]) -> tuple[float, T]:
    started_s = time.perf_counter()
    result = action()
    return time.perf_counter() - started_s, result
