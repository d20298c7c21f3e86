"""The MCAP form of a recording: opens in Foxglove, and holds what the folder form holds.

One channel and one protobuf schema for each stream, one flat fixed-width message for each sample
(`sample_messages`), `recording.json` as an attachment. Reading and writing go by whole chunks.
"""

from protocol.adapters.mcap_reading import examine_mcap, read_mcap
from protocol.adapters.mcap_writing import McapRecordingWriter, write_mcap

__all__ = ["McapRecordingWriter", "examine_mcap", "read_mcap", "write_mcap"]
