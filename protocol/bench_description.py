"""A bench as a station sees it: resource strings, nothing else.

An emulated bench writes this file when it is up; for hardware a person writes it. Going from one to
the other changes resource strings only:

  emulated                                          hardware
  lockstep://127.0.0.1:41002?link=1.rs422           /dev/ttyUSB0
  slcan on lockstep://127.0.0.1:41003?link=1.can    socketcan on can0
  TCPIP::127.0.0.1::41010::SOCKET                   TCPIP::192.0.2.7::5025::SOCKET
"""

from typing import Literal

from pydantic import Field

from protocol.frozen_model import FrozenModel


class SocketResources(FrozenModel):
    """One socket: the unit's links, the board's own controls (VISA), the supply's channel.

    `board` is None on a stand, where a unit is wired through without test points. `unit_link` is None for a
    unit that an instrument reads: analogue outputs, pulses.
    """

    socket: str
    unit_link: str | None = None
    can_interface: str | None = None
    can_channel: str | None = None
    board: str | None = None
    supply_channel: int = 1


class StandResources(FrozenModel):
    """A stand: command line (`host:port`, line protocol) and its stream (serial URL), if it has one."""

    stand_id: str
    kind: str = Field(min_length=1)
    command: str
    stream: str | None = None


class Site(FrozenModel):
    """Where the bench stands. `heading_deg`: azimuth of the stand's y axis, east of north."""

    latitude_deg: float = Field(ge=-90, le=90)
    gravity_m_s2: float = Field(gt=9.7, lt=9.9)
    heading_deg: float = 0.0


class BenchDescription(FrozenModel):
    """All of a bench. `control` is None on hardware. `bench_identity`: the fixture's own serial number.

    `serial_multimeter` is a serial URL (RS-232), `pulse_counter` a VISA resource: what reads a unit without a
    link of its own. `product`: of the units that are tested here.
    """

    format: Literal["testloom-bench/1"] = "testloom-bench/1"
    bench: str
    bench_identity: str
    operations: tuple[str, ...]
    product: str = "gnc_module"
    control: str | None = None
    pace: float = 1.0
    sockets: tuple[SocketResources, ...] = Field(min_length=1, max_length=64)
    power_supply: str
    multimeter: str | None = None
    oscilloscope: str | None = None
    serial_multimeter: str | None = None
    pulse_counter: str | None = None
    stand: StandResources | None = None
    site: Site
