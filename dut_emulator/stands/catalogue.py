# pyright: strict
"""Every kind of stand there is, by its name. A stand is imported when it is asked for."""

from importlib import import_module
from typing import Any

from dut_emulator.stands.recording_stand import LiveStand, RecordingStand
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError

STANDS: tuple[str, ...] = (
    "three_axis_turntable",
    "two_axis_turntable",
    "thermal_turntable",
    "non_magnetic_turntable",
    "rate_table",
    "impact_rig",
    "sinusoidal_overload_rig",
    "satellite_simulator",
    "vehicle_run_stand",
)
"""Each a module beside this file, or a folder, with `recording_stand` and `live_stand`."""


def recording_stand(kind: str, seed: int, site: Site) -> RecordingStand:
    """A stand of this kind whose own errors are drawn by `seed`.

    Raises:
        TestloomError: there is no such kind.
    """
    stand: RecordingStand = _module(kind).recording_stand(seed, site)
    return stand


def live_stand(kind: str, seed: int, site: Site, identity: str) -> LiveStand:
    """The same stand behind its command port. `identity`: the stand's serial number.

    Raises:
        TestloomError: there is no such kind.
    """
    stand: LiveStand = _module(kind).live_stand(seed, site, identity)
    return stand


def _module(kind: str) -> Any:
    if kind not in STANDS:
        raise TestloomError(
            f"There is no kind of stand '{kind}'.",
            where="stands",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(STANDS)}.",
        )
    return import_module(f"dut_emulator.stands.{kind}")
