"""Recordings in memory: streams of columns with units, and what is known of the test.

Two forms on disk hold the same things without loss: the folder form (`protocol/folder_form.py`)
and MCAP (`protocol/adapters/mcap_form.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, RecordingError
from protocol.units_of_measure import factor_to_si

FORMAT = "testloom-recording/1"


@dataclass(frozen=True)
class Stream:
    """Samples of one clock. Arrays are 1-D, of equal length, in the units the source gave.

    Attributes:
        name: 'dut' is what the unit sent, 'stand' what the stand's own encoders and probes report.
        clock: name of the clock that `time` was read from.
        time: name of the time column.
        units: column → unit of measure, the time column included, in the order of the columns.
        columns: column → samples. NaN in a data column is a missing value; never in the time.
        extra: keys of the stream in recording.json that the format does not name.
    """

    name: str
    clock: str
    time: str
    units: Mapping[str, str]
    columns: Mapping[str, NDArray[Any]]
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.columns[self.time])

    def has(self, *names: str) -> bool:
        """True if every one of these columns is there."""
        return all(name in self.columns for name in names)

    def si(self, *names: str) -> NDArray[np.float64]:
        """Columns in SI units: shape (n,) for one name, (n, k) for k names.

        Raises:
            RecordingError: a column is missing.
        """
        for name in names:
            if name not in self.columns:
                raise RecordingError(
                    f"The stream '{self.name}' has no column '{name}'.",
                    where=f"stream {self.name}, columns {', '.join(self.columns)}",
                    fault=Fault.DATA,
                    remedy="record this channel, or choose an evaluation that does not need it.",
                )
        converted = [
            np.asarray(self.columns[name], dtype=np.float64) * factor_to_si(self.units[name])
            for name in names
        ]
        return converted[0] if len(names) == 1 else np.stack(converted, axis=1)

    def time_s(self) -> NDArray[np.float64]:
        """The time column in seconds, shape (n,)."""
        return self.si(self.time)


@dataclass(frozen=True)
class Recording:
    """One recording. The mappings are `recording.json`'s own objects, kept whole for a lossless way back.

    Attributes:
        recording_id: names it among others.
        unit: serial and product.
        test: profile, run, mount, started_at, power_on_s …
        stand: id and kind; empty when unknown.
        site: latitude_deg, gravity_m_s2, field_uT; empty when unknown.
        streams: by name.
        believed: the simulator's knowledge of the unit when it was recorded.
        extra: top-level keys of recording.json that the format does not name.
    """

    recording_id: str
    unit: Mapping[str, Any]
    test: Mapping[str, Any]
    streams: Mapping[str, Stream]
    stand: Mapping[str, Any] = field(default_factory=dict)
    site: Mapping[str, Any] = field(default_factory=dict)
    believed: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def stream(self, name: str) -> Stream:
        """A stream by name.

        Raises:
            RecordingError: there is none of that name.
        """
        if name not in self.streams:
            raise RecordingError(
                f"The recording '{self.recording_id}' has no stream '{name}'.",
                where=f"recording {self.recording_id}, streams {', '.join(self.streams)}",
                fault=Fault.DATA,
                remedy="check that the recording is complete.",
            )
        return self.streams[name]
