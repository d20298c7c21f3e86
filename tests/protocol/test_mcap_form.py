"""The MCAP form against the mcap library's own reader and a protobuf decoder built from the schema."""

import dataclasses
import hashlib
import os
import re
from io import BytesIO

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import HealthCheck, given, settings
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from protocol.adapters import mcap_writing
from protocol.adapters.mcap_form import McapRecordingWriter, examine_mcap, read_mcap, write_mcap
from protocol.adapters.recording_forms import convert, read_recording
from protocol.errors import Fault, RecordingError
from protocol.folder_form import write_folder
from protocol.recording_checks import Findings, equal_recordings
from protocol.recordings import Recording, Stream
from tests.protocol.recording_samples import recordings, sample_recording

EPOCH_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z
SEVERAL_CHUNKS_BYTES = 1500


@pytest.fixture
def small_chunks(monkeypatch):
    """Chunks of a few samples, so that a small recording has several."""
    monkeypatch.setattr(mcap_writing, "CHUNK_BYTES", SEVERAL_CHUNKS_BYTES)


def decoder_of(schema):
    """A function from message bytes to a protobuf message, by nothing but the schema in the file."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString


def without_samples(recording: Recording) -> Recording:
    """What is known before the first sample."""
    empty = {
        name: Stream(
            *(name, stream.clock, stream.time, stream.units),
            {column: samples[:0] for column, samples in stream.columns.items()},
            stream.extra,
        )
        for name, stream in recording.streams.items()
    }
    return Recording(**{**vars(recording), "streams": empty})


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(recording=recordings())
def test_what_is_written_is_read(tmp_path_factory, recording):
    path = tmp_path_factory.mktemp("recording") / "r.mcap"
    reference = write_mcap(recording, path)
    assert equal_recordings(read_mcap(path), recording)
    content = path.read_bytes()
    assert reference.sha256 == hashlib.sha256(content).hexdigest()
    assert reference.size_bytes == len(content)
    assert reference.sample_count == sum(len(stream) for stream in recording.streams.values())


def test_other_readers_see_the_same_samples(tmp_path, small_chunks):
    recording = sample_recording(200)
    write_mcap(recording, tmp_path / "r.mcap")
    seen: dict[str, list] = {"/dut": [], "/stand": []}
    with (tmp_path / "r.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        for schema, channel, message in reader.iter_messages():
            seen[channel.topic].append((decoder_of(schema)(message.data), message))
        assert next(iter(reader.iter_attachments())).name == "recording.json"
        assert next(iter(reader.iter_metadata())).metadata["unit.serial"] == "U-1"
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 4
    assert {channel.topic: channel.metadata["clock"] for channel in summary.channels.values()} == {
        "/dut": "unit clock",
        "/stand": "stand",
    }
    for name, stream in recording.streams.items():
        messages = seen[f"/{name}"]
        for column, samples in stream.columns.items():
            decoded = [
                value
                for message, _ in messages
                for field in message.DESCRIPTOR.fields
                if field.json_name == column
                for value in [getattr(message, field.name)]
            ]
            np.testing.assert_array_equal(decoded, samples)
        expected_ns = EPOCH_NS + np.rint(stream.time_s() * 1e9).astype(np.int64)
        assert [record.log_time for _, record in messages] == expected_ns.tolist()
        assert [record.sequence for _, record in messages] == list(range(len(stream)))


def test_the_message_index_finds_a_part_by_time(tmp_path, small_chunks):
    write_mcap(sample_recording(200), tmp_path / "r.mcap")
    with (tmp_path / "r.mcap").open("rb") as file:
        found = list(
            make_reader(file).iter_messages(
                topics=["/dut"], starting_at=EPOCH_NS + 500_000_000, ending_before=EPOCH_NS + 600_000_000
            )
        )
    assert [message.sequence for _, _, message in found] == list(range(100, 120))


def test_a_long_run_is_written_piece_by_piece(tmp_path, small_chunks):
    recording = sample_recording(300)
    with McapRecordingWriter(tmp_path / "pieces.mcap", without_samples(recording)) as writer:
        for start in range(0, 300, 7):
            for name, stream in recording.streams.items():
                piece = {column: samples[start : start + 7] for column, samples in stream.columns.items()}
                writer.append(name, piece)
        (unfinished,) = os.listdir(tmp_path)
        assert re.fullmatch(r"pieces\.mcap\.\w+\.part", unfinished)
    assert os.listdir(tmp_path) == ["pieces.mcap"]
    assert equal_recordings(read_mcap(tmp_path / "pieces.mcap"), recording)
    assert writer.reference.sample_count == 450
    assert writer.close() == writer.reference


def test_time_of_a_unit_that_steps_back_is_kept_and_found(tmp_path):
    recording = sample_recording(20)
    with McapRecordingWriter(tmp_path / "r.mcap", without_samples(recording)) as writer:
        for _ in range(2):
            writer.append("dut", recording.streams["dut"].columns)
    with pytest.raises(RecordingError, match="steps backwards") as caught:
        read_mcap(tmp_path / "r.mcap")
    assert "stream dut, column t, row 21" in caught.value.where
    with (tmp_path / "r.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == 40


def test_an_interrupted_recording_leaves_nothing(tmp_path):
    recording = sample_recording()

    def station_that_stops():
        with McapRecordingWriter(tmp_path / "r.mcap", without_samples(recording)) as writer:
            writer.append("dut", recording.streams["dut"].columns)
            raise KeyError

    with pytest.raises(KeyError):
        station_that_stops()
    assert os.listdir(tmp_path) == []


def test_two_that_write_one_name_at_once_are_not_in_each_others_way(tmp_path):
    recording = sample_recording()
    slow_one = dataclasses.replace(without_samples(recording), recording_id="another")
    slow = McapRecordingWriter(tmp_path / "r.mcap", slow_one)
    with McapRecordingWriter(tmp_path / "r.mcap", without_samples(recording)) as quick:
        for name, stream in recording.streams.items():
            slow.append(name, stream.columns)
            quick.append(name, stream.columns)
    slow.discard()
    assert equal_recordings(read_recording(tmp_path / "r.mcap"), recording)
    assert os.listdir(tmp_path) == ["r.mcap"]


def test_a_full_disk_leaves_nothing(tmp_path, small_chunks, fill_disk):
    fill_disk(40_000)
    with pytest.raises(RecordingError, match="disk is full") as caught:
        write_mcap(sample_recording(20_000), tmp_path / "r.mcap")
    assert caught.value.fault is Fault.STATION
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"gyro_x": None}, "not those declared: gyro_x"),
        ({"more": np.zeros(50)}, "not those declared: more"),
        ({"gyro_x": np.zeros(49)}, "different lengths"),
        ({"counter": np.zeros(50)}, "'float64' cannot be kept as 'uint8'"),
    ],
)
def test_samples_that_were_not_declared_are_refused(tmp_path, change, says):
    recording = sample_recording()
    columns = {**recording.streams["dut"].columns, **change}
    columns = {name: samples for name, samples in columns.items() if samples is not None}
    writer = McapRecordingWriter(tmp_path / "r.mcap", without_samples(recording))
    with pytest.raises(RecordingError, match=says):
        writer.append("dut", columns)
    writer.discard()


def test_no_damaged_byte_stays_unseen(tmp_path, small_chunks):
    path = tmp_path / "r.mcap"
    write_mcap(sample_recording(60), path)
    sound = path.read_bytes()
    for place in range(0, len(sound), 13):
        damaged = bytearray(sound)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        findings = Findings()
        assert examine_mcap(path, findings) is None, f"byte {place}"
        assert all(error.where.startswith(str(path)) for error in findings.errors)


def test_no_truncated_file_passes(tmp_path, small_chunks):
    path = tmp_path / "r.mcap"
    write_mcap(sample_recording(60), path)
    sound = path.read_bytes()
    for end in [*range(0, len(sound), 97), len(sound) - 1]:
        path.write_bytes(sound[:end])
        with pytest.raises(RecordingError, match=r"cut short|no MCAP|end is missing") as caught:
            read_mcap(path)
        assert f"byte {end}" in caught.value.where or "byte 0" in caught.value.where


def test_every_damaged_chunk_is_named(tmp_path, small_chunks):
    path = tmp_path / "r.mcap"
    write_mcap(sample_recording(200), path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    content = bytearray(path.read_bytes())
    for chunk in (chunks[1], chunks[3]):
        content[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 4
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="chunk is damaged") as caught:
        read_mcap(path)
    start = chunks[1].chunk_start_offset
    assert (
        f"chunk 2 of {len(chunks)}, bytes {start} to {start + chunks[1].chunk_length}" in caught.value.where
    )
    rows = (
        chunks[0].uncompressed_size
        * 200
        // sum(chunk.uncompressed_size for chunk in chunks if chunk.message_index_offsets.keys() == {1})
    )
    assert f"stream dut, rows {rows + 1} to {2 * rows}" in caught.value.where
    (other,) = caught.value.story
    assert f"chunk 4 of {len(chunks)}" in other
    assert f"stream dut, rows {3 * rows + 1} to {4 * rows}" in other


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_file_that_another_tool_has_rewritten_is_read(tmp_path, compression):
    recording = sample_recording(100)
    write_mcap(recording, tmp_path / "ours.mcap")
    out = BytesIO()
    writer = Writer(out, compression=compression)
    writer.start()
    with (tmp_path / "ours.mcap").open("rb") as file:
        reader = make_reader(file)
        attachment = next(iter(reader.iter_attachments()))
        writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():  # both streams, mixed by time
            assert schema is not None
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", schema_id)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
    writer.finish()
    (tmp_path / "theirs.mcap").write_bytes(out.getvalue())
    assert equal_recordings(read_mcap(tmp_path / "theirs.mcap"), recording)


def test_an_mcap_file_of_something_else_is_refused(tmp_path):
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    writer.finish()
    (tmp_path / "r.mcap").write_bytes(out.getvalue())
    with pytest.raises(RecordingError, match="no recording of ours"):
        read_mcap(tmp_path / "r.mcap")


def test_conversion_goes_both_ways_without_loss(tmp_path):
    recording = sample_recording()
    write_folder(recording, tmp_path / "a", "csv")
    convert(tmp_path / "a", tmp_path / "b.mcap")
    convert(tmp_path / "b.mcap", tmp_path / "c", "parquet")
    convert(tmp_path / "c" / "recording.json", tmp_path / "d.mcap")
    for name in ("a", "b.mcap", "c", "d.mcap"):
        assert equal_recordings(read_recording(tmp_path / name), recording)
    assert (tmp_path / "b.mcap").read_bytes() == (tmp_path / "d.mcap").read_bytes()
    with pytest.raises(RecordingError, match="already"):
        convert(tmp_path / "a", tmp_path / "b.mcap")


@pytest.mark.parametrize(
    ("name", "says"), [("gone", "no such file"), ("r.bag", "no recording"), ("e.mcap", "empty")]
)
def test_what_is_no_recording_is_said_to_be_none(tmp_path, name, says):
    (tmp_path / "r.bag").write_text("x")
    (tmp_path / "e.mcap").touch()
    with pytest.raises(RecordingError, match=says):
        read_recording(tmp_path / name)


def test_a_chunk_is_not_unpacked_beyond_the_size_it_was_announced_with():
    """A few kilobytes may claim to hold gigabytes: memory is given for what the index announces."""
    from lz4.frame import compress
    from zstandard import ZstdCompressor

    from protocol.adapters.mcap_reading import _decompressed

    large, announced = bytes(50_000_000), 1000
    with pytest.raises(ValueError, match="50000000 bytes, not 1000"):
        _decompressed(memoryview(ZstdCompressor().compress(large)), "zstd", announced)
    assert len(_decompressed(memoryview(compress(large)), "lz4", announced)) == announced
