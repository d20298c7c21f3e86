"""Every product on every profile that it can undergo: recorded into both forms, read back, held to a number.

The numbers are in `oracles_<product>.py`: profile → a function that asserts figures of the recording against
closed form or the published vectors.
"""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from dut_emulator.products.catalogue import PRODUCTS, product_named
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession, recorded
from dut_emulator.recording.recording_files import write_recording
from dut_emulator.stands.catalogue import STANDS
from protocol.adapters.recording_forms import read_recording
from protocol.recording_checks import equal_recordings
from protocol.recordings import Recording

DOCUMENT = Path(__file__).parents[2] / "docs" / "emulator.md"
CHUNK_SAMPLES = 7_919
"""Prime, and another cut than the recorder's own: the samples must not know of it."""

MAX_SAMPLES_TWICE = 200_000
"""Longer runs are not made a second time, in memory, to be compared."""

THERE = [name for name in PRODUCTS if find_spec(f"dut_emulator.products.{name}.product")]
PAIRS = [(name, profile) for name in THERE for profile in product_named(name).profiles]


def oracles_of(product: str) -> dict[str, Callable[[Recording], None]]:
    return import_module(f"tests.dut_emulator_recordings.oracles_{product}").ORACLES


def test_every_product_is_there() -> None:
    assert tuple(THERE) == PRODUCTS


@pytest.mark.parametrize("product", THERE)
def test_every_pair_has_a_stand_and_a_number(product: str) -> None:
    profiles = product_named(product).profiles
    assert profiles.keys() <= oracles_of(product).keys()
    assert {mounting.stand for mounting in profiles.values()} <= set(STANDS)


@pytest.mark.parametrize("product", THERE)
def test_the_document_says_what_runs_where(product: str) -> None:
    """A failure shows the rows as they ought to be."""
    by_stand: dict[str, list[str]] = {}
    for profile, mounting in product_named(product).profiles.items():
        by_stand.setdefault(mounting.stand, []).append(f"`{profile}`")
    rows = [f"| `{product}` | `{stand}` | {', '.join(profiles)} |" for stand, profiles in by_stand.items()]
    told = DOCUMENT.read_text(encoding="utf-8").splitlines()
    assert [row for row in told if row.startswith(f"| `{product}` |")] == rows


@pytest.mark.parametrize(("product", "profile"), PAIRS)
def test_it_is_recorded_in_both_forms_and_is_right(product: str, profile: str, tmp_path: Path) -> None:
    session = RecordingSession(RecordingOrder(product, profile))
    folder, mcap = write_recording(session, tmp_path, chunk_samples=CHUNK_SAMPLES)
    kept = read_recording(folder)
    assert equal_recordings(kept, read_recording(mcap))
    if session.duration_s * session.unit.rate_hz < MAX_SAMPLES_TWICE:
        assert equal_recordings(kept, recorded(product, profile))
    _check_sound(kept, session)
    oracles_of(product)[profile](kept)


def _check_sound(recording: Recording, session: RecordingSession) -> None:
    """What holds for any recording: the streams are full, and the truth is not among what is told."""
    dut, stand = recording.streams["dut"], recording.streams["stand"]
    period_s = 1 / min(session.unit.rate_hz, session.unit.run.reading_rate_hz)
    for stream in (dut, stand):
        time_s = stream.time_s()
        assert len(time_s) > 1
        assert time_s[0] == pytest.approx(0.0, abs=0.1)
        assert time_s[-1] == pytest.approx(session.duration_s, abs=period_s + 0.1)
    for name, samples in dut.columns.items():
        assert np.isfinite(samples).any(), f"{name} has no value"
    told = str((recording.unit, recording.test, recording.stand, recording.extra))
    assert "stand." not in told
    assert "effects" not in told
