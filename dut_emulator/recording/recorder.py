# pyright: strict
"""A unit, a profile and a stand become a recording, chunk by chunk.

    session = RecordingSession(RecordingOrder("mems_ahrs", "swing"))
    record_to(session, writers)         # any number of forms, in bounded memory
    recording = recorded("mems_ahrs", "swing")   # or all of it in memory

The recording holds what a real bench would know: what unit and stand sent, who they are, what was commanded,
and what the simulator believes of the unit. The truth behind it (the unit's effects, the stand's errors, the
offset of clocks that no trigger joins) is not in it; `RecordingSession.truth` has it.
"""

import dataclasses
import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, datetime
from typing import Any, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from dut_emulator import gimbal_geometry
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName
from dut_emulator.lot import LotDraw
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.products.catalogue import product_named
from dut_emulator.products.product import (
    Product,
    UnitOnStand,
    UnitStreams,
    chain_effects,
    sample_times_s,
)
from dut_emulator.recording.order import FIRST_MOUNT, RecordingOrder, check_order
from dut_emulator.stands.catalogue import recording_stand
from dut_emulator.stands.recording_stand import CarriesUnitsInSeveralWays, RecordingStand
from dut_emulator.twin import Twin, twin_text
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError
from protocol.recordings import Recording, Stream

CHUNK_SAMPLES = 16_384
"""So many of the faster stream are made at once: arrays of a triad still fit a processor's cache."""
TRUTH_FORMAT = "testloom-truth/1"

_RUN_NOISE = 9_001
"""Purpose of `LotDraw.seed_for`: apart from what a unit draws for itself."""
_FRAME_RATE = "frame_rate_hz"
_MOUNTING_EFFECT = "remount_misalignment"

Columns = dict[str, NDArray[Any]]
Chunk = dict[str, Columns]


class RecordingWriter(Protocol):
    """What a form's writer offers: `McapRecordingWriter`, `FolderRecordingWriter`."""

    def append(self, stream: str, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add samples to a stream."""
        ...


class RecordingSession:
    """An order that can be carried out: everything is looked up and checked, nothing has moved.

    Raises:
        TestloomError: no such product, profile, stand or parameter; a profile that the product cannot
            undergo or that is beyond the stand's limits; another product's twin, or one that does not fit.
    """

    def __init__(self, order: RecordingOrder) -> None:
        check_order(order)
        product = product_named(order.product) if isinstance(order.product, str) else order.product
        _check(order, product)
        profile = profile_named(order.profile)
        values = profile.values(order.values)
        mounting = product.profiles[order.profile]
        twin = order.twin or product.twin(order.seed, order.serial)
        stand = recording_stand(mounting.stand, order.stand_seed, order.site)
        draw = LotDraw(order.seed, order.serial)
        self.order, self.twin, self.stand = order, twin, stand
        self._defects = () if order.twin is not None else product.defects(order.seed, order.serial)
        self.unit = UnitOnStand(
            twin=twin,
            stand_effects=_effects_of_mount(stand, order, mounting.stand, values),
            run=stand.run(order.profile, values),
            rate_hz=order.rate_hz or mounting.rate_hz,
            seed=draw.seed_for(_RUN_NOISE, order.run, *f"{order.profile}/{order.mount}".encode()),
            serial=order.serial,
            power_on_s=-order.powered_before_s,
        )
        self._product = product
        self._offset_s = 0.0 if order.triggered else order.clock_offset_s
        test = {
            "profile": order.profile,
            "run": order.run,
            "mount": order.mount,
            "started_at": order.started_at,
            "values": values,
            "value_units": {parameter.name: parameter.unit for parameter in profile.parameters},
            "triggered": order.triggered,
            **({"power_on_s": self.unit.power_on_s} if order.powered_before_s else {}),
            **({"rate_hz": order.rate_hz} if order.rate_hz else {}),
        }
        self.description = Recording(
            recording_id=f"{product.name}-{order.serial}-{order.profile}-{order.mount}-r{order.run}",
            unit={"serial": order.serial, "product": product.name},
            test=test,
            stand=self._stand_mapping(),
            site=_site_mapping(order.site),
            believed=product.believed(twin),
            streams=self._empty_streams(product.begin(self.unit)),
        )

    @property
    def duration_s(self) -> float:
        """Of the run."""
        return self.unit.run.duration_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know before using the recording."""
        if "calibration_overdue" not in self.description.stand:
            return ()
        identity = self.stand.identity
        return (f"The calibration of stand {identity.stand_id} was due on {identity.calibration_due}.",)

    def chunks(self, chunk_samples: int = CHUNK_SAMPLES) -> Iterator[tuple[float, Chunk]]:
        """(bench time reached, stream → column → samples) until the run is over; the same each time."""
        run = self.unit.run
        streams = self._product.begin(self.unit)
        step_s = chunk_samples / max(self.unit.rate_hz, run.reading_rate_hz)
        steps = max(1, math.ceil(self.duration_s / step_s))
        first = 0
        for step in range(1, steps + 1):
            to_s = self.duration_s if step == steps else step * step_s
            sent = streams.advance(to_s)
            times_s = sample_times_s(first, to_s, run.reading_rate_hz)
            first += len(times_s)
            read = {"t": times_s + self._offset_s, **run.reading(times_s)}
            chunk = {name: self._as_declared(name, columns) for name, columns in sent.items()}
            yield to_s, chunk | {"stand": self._as_declared("stand", read)}
        events = {event.name: self._on_stand_clock(event.columns) for event in run.events()}
        if events:
            yield self.duration_s, {name: self._as_declared(name, events[name]) for name in events}

    def truth(self) -> dict[str, Any]:
        """What the recording does not tell: the unit's and the stand's effects, the clocks' offset."""
        order = self.order
        own = set(self.twin.effects)
        acting = (
            effect
            for sensor in get_args(SensorName)
            for effect in chain_effects(self.twin, self.unit.stand_effects, sensor)
            if effect not in own
        )
        stand = Twin(self.stand.identity.kind, tuple(sorted(acting, key=_sensor_and_stage)))
        return {
            "format": TRUTH_FORMAT,
            "recording_id": self.description.recording_id,
            "seed": order.seed,
            "stand_seed": order.stand_seed,
            "stand_clock_ahead_s": self._offset_s,
            "defects": list(self._defects),
            "unit": json.loads(twin_text(self.twin)),
            "stand": json.loads(twin_text(stand)),
        }

    def _stand_mapping(self) -> dict[str, Any]:
        identity = self.stand.identity
        due = date.fromisoformat(identity.calibration_due)
        overdue = datetime.fromisoformat(self.order.started_at).date() > due
        return {
            "id": identity.stand_id,
            "kind": identity.kind,
            "calibration_due": identity.calibration_due,
            "emulated": True,  # nobody may take what follows from it for a real unit's figures
            **({"calibration_overdue": True} if overdue else {}),
        }

    def _empty_streams(self, unit: UnitStreams) -> dict[str, Stream]:
        """The streams as declared, without samples: units and types."""
        run = self.unit.run
        now = np.zeros(1)
        read = {"t": now, **run.reading(now)}
        empty = {
            shape.name: _empty_stream(shape.name, shape.clock, shape.units, shape.types)
            for shape in unit.shapes
        }
        types = {name: samples.dtype.name for name, samples in read.items()}
        empty["stand"] = _empty_stream("stand", "stand", {"t": "s", **run.reading_units}, types)
        for event in run.events():
            types = {name: samples.dtype.name for name, samples in event.columns.items()}
            empty[event.name] = _empty_stream(event.name, "stand", event.units, types)
        return {name: self._with_sample_type(stream) for name, stream in empty.items()}

    def _with_sample_type(self, stream: Stream) -> Stream:
        columns = {
            name: samples.astype(self.order.sample_type)
            if samples.dtype.kind == "f" and name != stream.time
            else samples
            for name, samples in stream.columns.items()
        }
        return dataclasses.replace(stream, columns=columns)

    def _as_declared(self, name: str, columns: Mapping[str, NDArray[Any]]) -> Columns:
        """Columns in the declared order and type; whole numbers may not be made of others."""
        declared = self.description.streams[name].columns
        if set(columns) != set(declared):
            raise TestloomError(
                f"The stream '{name}' declares {', '.join(declared)}, but has {', '.join(columns)}.",
                where=f"recording {self.description.recording_id}",
                remedy="send us this error.",
            )
        return {
            column: columns[column].astype(empty.dtype, casting="same_kind", copy=False)
            for column, empty in declared.items()
        }

    def _on_stand_clock(self, columns: Mapping[str, NDArray[Any]]) -> Columns:
        return {**columns, "t": columns["t"] + self._offset_s}


def record_to(
    session: RecordingSession,
    writers: Sequence[RecordingWriter],
    progress: Callable[[float], None] | None = None,
    chunk_samples: int = CHUNK_SAMPLES,
) -> None:
    """Carry out a session into writers that are open; whoever opened them closes them.

    Args:
        session: what to record.
        writers: each gets every chunk.
        progress: told the bench time that is reached, after each chunk.
        chunk_samples: the bound of what is in memory at once, in samples of the fastest stream.
    """
    for reached_s, chunk in session.chunks(chunk_samples):
        for name, columns in chunk.items():
            for writer in writers:
                writer.append(name, columns)
        if progress is not None:
            progress(reached_s)


def recorded(product: str | Product, profile: str, **ordered: Any) -> Recording:
    """A whole recording in memory.

    Args:
        product: see `RecordingOrder`, as for all that follows.
        profile: likewise.
        **ordered: the other fields of `RecordingOrder`.

    Raises:
        TestloomError: as `RecordingSession`.
    """
    session = RecordingSession(RecordingOrder(product, profile, **ordered))
    pieces: dict[str, list[Columns]] = {name: [] for name in session.description.streams}
    for _, chunk in session.chunks():
        for name, columns in chunk.items():
            pieces[name].append(columns)
    streams = {
        name: dataclasses.replace(stream, columns=_joined(stream.columns, pieces[name]))
        for name, stream in session.description.streams.items()
    }
    return dataclasses.replace(session.description, streams=streams)


def _joined(empty: Mapping[str, NDArray[Any]], pieces: list[Columns]) -> Columns:
    return {
        name: np.concatenate([samples, *(piece[name] for piece in pieces)]) for name, samples in empty.items()
    }


def _empty_stream(name: str, clock: str, units: Mapping[str, str], types: Mapping[str, str]) -> Stream:
    columns = {column: np.empty(0, dtype=types[column]) for column in units}
    return Stream(name, clock, "t", dict(units), columns)


def _effects_of_mount(
    stand: RecordingStand, order: RecordingOrder, kind: str, values: Mapping[str, float]
) -> tuple[CatalogueEffect, ...]:
    """The stand's effects; what mounting a unit changes is drawn anew for every mount but the first."""
    own = stand.effects_of(values) if isinstance(stand, CarriesUnitsInSeveralWays) else stand.effects
    if order.mount == FIRST_MOUNT:
        return own
    seed = zlib.crc32(f"{order.stand_seed}/{order.mount}".encode())
    remounted = recording_stand(kind, seed, order.site).effects
    return tuple(
        another if effect.word == _MOUNTING_EFFECT else effect
        for effect, another in zip(own, remounted, strict=True)
    )


def _site_mapping(site: Site) -> dict[str, Any]:
    """As a bench knows its place; the field is north, east, down."""
    east, north, up = gimbal_geometry.FIELD_EAST_NORTH_UP_T
    return {
        "latitude_deg": site.latitude_deg,
        "gravity_m_s2": site.gravity_m_s2,
        "heading_deg": site.heading_deg,
        "field_uT": [round(component * 1e6, 6) for component in (north, east, -up)],
    }


def _check(order: RecordingOrder, product: Product) -> None:
    """What can be refused before a stand is asked."""
    possible = ", ".join(product.profiles)
    if order.profile not in product.profiles:
        profile_named(order.profile)  # a name that nobody knows is another error
        raise _refused(
            f"A {product.name} cannot undergo the profile '{order.profile}'.",
            f"product {product.name}",
            f"use one of: {possible}.",
        )
    names = [parameter.name for parameter in profile_named(order.profile).parameters]
    if order.rate_hz is not None and _FRAME_RATE in names:
        raise _refused(
            f"In the profile '{order.profile}' the unit's samples are frames with a rate of their own.",
            "rate_hz",
            f"set the profile's {_FRAME_RATE} instead.",
        )
    if order.twin is not None and order.twin.product not in ("", product.name):
        raise _refused(
            f"The twin is one of a {order.twin.product}, not of a {product.name}.",
            "twin, product",
            "give a twin of this product.",
        )
    try:
        datetime.fromisoformat(order.started_at)
    except ValueError as error:
        raise _refused(
            f"'{order.started_at}' is no date and time.", "started_at", "write it as 2026-01-01T00:00:00Z."
        ) from error


def _sensor_and_stage(effect: CatalogueEffect) -> tuple[str, int]:
    return effect.sensor, effect.stage


def _refused(what: str, where: str, remedy: str) -> TestloomError:
    return TestloomError(what, where=where, fault=Fault.OPERATOR, remedy=remedy)
