"""A product and a stand so simple that every sample of their recordings is known beforehand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from dut_emulator.effects.effect import Stimulus
from dut_emulator.effects.stand import RemountMisalignment
from dut_emulator.motion.profile import ProfileKind, ProfileParameter
from dut_emulator.motion.profile_catalogue import PROFILES
from dut_emulator.motion.run import EventStream
from dut_emulator.products.product import Mounting, StreamShape, UnitOnStand, sample_times_s
from dut_emulator.recording import recorder
from dut_emulator.stands.recording_stand import StandIdentity
from dut_emulator.twin import Twin
from protocol.bench_description import Site

SPIN = ProfileKind(
    "plain_spin",
    "one rate about z",
    (
        ProfileParameter("rate", 10.0, "deg/s", 0.0, 100.0, "of the table"),
        ProfileParameter("duration", 2.0, "s", 0.1, 1e6, "of the run"),
    ),
)
UNIT_RATE_HZ, STAND_RATE_HZ = 1000.0, 400.0
MARK_EVERY_S = 0.5


@dataclass(frozen=True)
class PlainRun:
    """A constant rate about z, read exactly; a mark on the table passes every half second."""

    rate_deg_s: float
    duration_s: float
    reading_rate_hz = STAND_RATE_HZ
    reading_units: ClassVar = {"rate_z": "deg/s"}
    trigger_times_s = np.zeros(1)

    def stimulus(self, times_s: np.ndarray) -> Stimulus:
        return Stimulus(times_s, np.full(len(times_s), 23.0), np.nan)

    def reading(self, times_s: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"rate_z": np.full(len(times_s), self.rate_deg_s)}

    def events(self) -> tuple[EventStream, ...]:
        times_s = np.arange(0.0, self.duration_s, MARK_EVERY_S)
        counts = np.arange(len(times_s), dtype=np.uint32)
        return (EventStream("mark", {"t": "s", "counter": "1"}, {"t": times_s, "counter": counts}),)


class PlainStand:
    """Its calibration holds until the middle of 2026; a remount turns the unit a little."""

    def __init__(self, seed: int) -> None:
        self.identity = StandIdentity("plain_table", f"pt-{seed}", "2026-06-30")
        self.effects = (RemountMisalignment("gyro", rotation_rad=(seed * 1e-4, 0.0, 0.0)),)

    def run(self, profile: str, values: Mapping[str, float]) -> PlainRun:
        return PlainRun(values["rate"], values["duration"])


class PlainStreams:
    """Sends its clock's ticks, and a noise that any cut into chunks gives alike."""

    shapes = (
        StreamShape(
            "dut",
            {"t": "s", "counter": "1", "gyro_z": "deg/s"},
            {"t": "float64", "counter": "int32", "gyro_z": "float64"},
        ),
    )

    def __init__(self, unit: UnitOnStand) -> None:
        self._unit = unit
        self._rng = np.random.Generator(np.random.PCG64(unit.seed))
        self._sent = 0

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, Any]]:
        times_s = sample_times_s(self._sent, to_s, self._unit.rate_hz)
        counter = np.arange(self._sent, self._sent + len(times_s), dtype=np.int32)
        self._sent += len(times_s)
        return {"dut": {"t": times_s, "counter": counter, "gyro_z": self._rng.standard_normal(len(times_s))}}


class PlainProduct:
    """See the module."""

    name = "plain_unit"
    profiles: ClassVar = {SPIN.name: Mounting("plain_table", UNIT_RATE_HZ)}

    def twin(self, seed: int, serial: str) -> Twin:
        return Twin(self.name)

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        return ("never seen",)

    def believed(self, twin: Twin) -> dict[str, Any]:
        return {"gyro": {"unit": "deg/s", "bias": [0, 0, 0]}}

    def begin(self, unit: UnitOnStand) -> PlainStreams:
        return PlainStreams(unit)


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> PlainProduct:
    """The product, with its stand and profile in the catalogues."""

    def stand(kind: str, seed: int, site: Site) -> PlainStand:
        assert kind == "plain_table"
        return PlainStand(seed)

    monkeypatch.setitem(PROFILES, SPIN.name, SPIN)
    monkeypatch.setattr(recorder, "recording_stand", stand)
    return PlainProduct()
