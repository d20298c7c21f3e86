"""Samples as MCAP message records, built and taken apart by numpy: one flat protobuf message each.

Every column is a field of fixed width (double, float, fixed32, sfixed32, fixed64, sfixed64, bool),
numbered in the order of the columns and always written, zeros too, so that all messages of a stream
have one length and a whole chunk is one array of records:

    opcode u8 = 5 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64 | message

Any protobuf decoder reads the message by the schema that stands in the file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from numpy.typing import NDArray

MESSAGE_OPCODE = 5
MESSAGE_HEAD_BYTES = 9  # opcode and length of a record
PACKAGE = "testloom"

_LONGEST_S = 4e9  # with an epoch of today, nanoseconds still fit into 63 bits
_VARINT, _FIXED64, _FIXED32 = 0, 1, 5
_F = FieldDescriptorProto
# type of the samples -> (protobuf type, wire type, type on the wire)
_WIRE: dict[str, tuple[Any, int, str]] = {
    "float64": (_F.TYPE_DOUBLE, _FIXED64, "<f8"),
    "float32": (_F.TYPE_FLOAT, _FIXED32, "<f4"),
    "int64": (_F.TYPE_SFIXED64, _FIXED64, "<i8"),
    "uint64": (_F.TYPE_FIXED64, _FIXED64, "<u8"),
    "int32": (_F.TYPE_SFIXED32, _FIXED32, "<i4"),
    "int16": (_F.TYPE_SFIXED32, _FIXED32, "<i4"),
    "int8": (_F.TYPE_SFIXED32, _FIXED32, "<i4"),
    "uint32": (_F.TYPE_FIXED32, _FIXED32, "<u4"),
    "uint16": (_F.TYPE_FIXED32, _FIXED32, "<u4"),
    "uint8": (_F.TYPE_FIXED32, _FIXED32, "<u4"),
    "bool": (_F.TYPE_BOOL, _VARINT, "u1"),  # a varint of 0 or 1 always has one byte
}


@dataclass(frozen=True)
class SampleLayout:
    """How the samples of one stream lie in its messages.

    Attributes:
        stream: its name.
        channel_id: of the MCAP channel.
        types: column → type of its samples, in the order of the columns.
        units: column → unit.
    """

    stream: str
    channel_id: int
    types: Mapping[str, str]
    units: Mapping[str, str]

    @property
    def schema_name(self) -> str:
        """Full name of the message type."""
        return f"{PACKAGE}.{_identifier(self.stream)}"

    def schema(self) -> bytes:
        """The message type as a serialised FileDescriptorSet, units in the comments of its fields."""
        file = FileDescriptorProto(name=f"{_identifier(self.stream)}.proto", package=PACKAGE, syntax="proto3")
        message = file.message_type.add(name=_identifier(self.stream))
        taken: set[str] = set()
        for number, (column, kind) in enumerate(self.types.items(), 1):
            name = _identifier(column)
            while name in taken:
                name += "_"
            taken.add(name)
            # the column's own name as JSON name: proto3 would refuse gyro_x beside gyroX else
            message.field.add(
                name=name, json_name=column, number=number, type=_WIRE[kind][0], label=_F.LABEL_OPTIONAL
            )
            comment = file.source_code_info.location.add(path=(4, 0, 2, number - 1), span=(number, 0, 0))
            comment.leading_comments = f" {column} in {self.units[column]}\n"
        return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)

    @cached_property
    def record(self) -> np.dtype[np.void]:
        """The whole message record as a packed numpy type; column i is the field `v<i>`."""
        fields: list[tuple[str, str]] = [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
        ]
        for number, kind in enumerate(self.types.values(), 1):
            fields += [(f"tag{number}", "u1" if number < 16 else "<u2"), (f"v{number}", _WIRE[kind][2])]
        return np.dtype(fields)

    @cached_property
    def template(self) -> NDArray[np.void]:
        """One record with everything that is the same in all of them: shape (1,)."""
        row = np.zeros(1, dtype=self.record)
        row["opcode"] = MESSAGE_OPCODE
        row["length"] = self.record.itemsize - MESSAGE_HEAD_BYTES
        row["channel"] = self.channel_id
        for number, kind in enumerate(self.types.values(), 1):
            tag = number << 3 | _WIRE[kind][1]
            row[f"tag{number}"] = tag if number < 16 else (tag & 0x7F | 0x80) | tag >> 7 << 8
        return row

    def encode(
        self, columns: Mapping[str, NDArray[Any]], first_sequence: int, log_times: NDArray[np.uint64]
    ) -> NDArray[np.void]:
        """Message records of these samples, shape (n,), contiguous."""
        count = len(log_times)
        content = np.empty((count, self.record.itemsize), dtype=np.uint8)
        content[:] = self.template.view(np.uint8)
        rows: NDArray[np.void] = content.view(self.record)[:, 0]
        rows["sequence"] = (first_sequence + np.arange(count)) & 0xFFFF_FFFF
        rows["log_time"] = log_times
        rows["publish_time"] = log_times
        for number, column in enumerate(self.types, 1):
            rows[f"v{number}"] = columns[column]
        return rows

    def fits(self, rows: NDArray[np.void]) -> bool:
        """True if every record has the length, channel and field tags of this layout."""
        constant = ["opcode", "length", "channel", *(f"tag{i}" for i in range(1, len(self.types) + 1))]
        return all(bool((rows[name] == self.template[name]).all()) for name in constant)

    def decode_into(self, rows: NDArray[np.void], columns: Mapping[str, NDArray[Any]], start: int) -> None:
        """Put the samples of these records into the columns, from row `start` on."""
        for number, column in enumerate(self.types, 1):
            columns[column][start : start + len(rows)] = rows[f"v{number}"]


def log_times_ns(time: NDArray[Any], unit_s: float, epoch_ns: int) -> NDArray[np.uint64]:
    """Time column → nanoseconds on the time axis of a viewer, shape (n,).

    Only for showing: the time column itself is in the message. A time that an unsigned number of
    nanoseconds cannot hold (before the epoch, NaN) is shown at the nearest end of the axis.
    """
    seconds = np.nan_to_num(time.astype(np.float64) * unit_s, nan=0.0)
    nanoseconds = np.rint(np.clip(seconds, -_LONGEST_S, _LONGEST_S) * 1e9).astype(np.int64)
    return np.maximum(nanoseconds + epoch_ns, 0).astype(np.uint64)


def _identifier(name: str) -> str:
    """A protobuf identifier as near to this name as can be."""
    cleaned = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return cleaned if cleaned and not cleaned[0].isdigit() else f"_{cleaned}"
