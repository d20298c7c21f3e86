# pyright: strict
"""What is to be recorded: a unit, a profile, a stand, and how it is started. Pure data."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from dut_emulator.products.product import Product
from dut_emulator.twin import Twin
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError

LABORATORY = Site(latitude_deg=39.96, gravity_m_s2=9.8013)
"""Where it is recorded if nothing is said."""
FIRST_MOUNT = "m1"
STARTED_AT = "2026-01-01T00:00:00Z"
"""The clock is an input: without a date of its own a recording is the same on every day."""
UNTRIGGERED_OFFSET_S = 0.013
"""Between two clocks that were started by hand (paper 2: 2.6° of error at 200 °/s)."""
MAX_RUN = 999_999
MAX_OFFSET_S = 1e6
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""Of what becomes a part of a file's name."""

LEAST_RATE_HZ, MAX_RATE_HZ = 1.0, 10_000.0

SampleType = Literal["float64", "float32"]


@dataclass(frozen=True)
class RecordingOrder:
    """One recording, before it is made. The same order gives the same samples.

    Attributes:
        product: its name, or a product of one's own.
        profile: one that this product can undergo.
        values: of the profile's parameters, each in its unit; the others are at their defaults.
        twin: the unit's true effects; None draws the unit of this seed and serial number.
        seed: of the lot that the unit comes from, and of its noise.
        serial: which unit of the lot.
        stand_seed: which stand of its kind.
        site: where it stands.
        triggered: both clocks are started by one edge; else the stand's is ahead by `clock_offset_s`.
        run: number of the run; each has noise of its own.
        mount: how the unit was mounted; what remounting changes is drawn anew for each name.
        powered_before_s: how long the unit had been powered when the run began.
        started_at: ISO date and time.
        sample_type: of samples that are no whole numbers; times are always float64.
        rate_hz: of the unit's samples; None is what its product sends in this profile.
    """

    product: str | Product
    profile: str
    values: Mapping[str, float] = field(default_factory=dict[str, float])
    twin: Twin | None = None
    seed: int = 1
    serial: str = "U-0001"
    stand_seed: int = 1
    site: Site = LABORATORY
    triggered: bool = True
    clock_offset_s: float = UNTRIGGERED_OFFSET_S
    run: int = 1
    mount: str = FIRST_MOUNT
    powered_before_s: float = 0.0
    started_at: str = STARTED_AT
    sample_type: SampleType = "float64"
    rate_hz: float | None = None


def check_order(order: RecordingOrder) -> None:
    """What can be refused before a product is asked.

    Raises:
        TestloomError: a seed, name or number that cannot be.
    """
    check_unit(order.seed, order.serial)
    for name, given, good, expected in (
        ("stand_seed", order.stand_seed, 0 <= order.stand_seed < 2**63, _SEEDS),
        ("mount", order.mount, _NAME.fullmatch(order.mount) is not None, _NAMES),
        ("run", order.run, 0 <= order.run <= MAX_RUN, f"a whole number from 0 to {MAX_RUN}"),
        (
            "powered_before_s",
            order.powered_before_s,
            0 <= order.powered_before_s <= MAX_OFFSET_S,
            f"0 to {MAX_OFFSET_S:g} s",
        ),
        (
            "clock_offset_s",
            order.clock_offset_s,
            abs(order.clock_offset_s) <= MAX_OFFSET_S,
            f"-{MAX_OFFSET_S:g} to {MAX_OFFSET_S:g} s",
        ),
        (
            "rate_hz",
            order.rate_hz,
            order.rate_hz is None or LEAST_RATE_HZ <= order.rate_hz <= MAX_RATE_HZ,
            f"{LEAST_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz",
        ),
    ):
        if not good:
            raise _refused(name, given, expected)


def check_unit(seed: int, serial: str) -> None:
    """What can be refused before a unit is drawn; the serial number becomes a part of file names.

    Raises:
        TestloomError: a seed or a serial number that cannot be.
    """
    if not 0 <= seed < 2**63:
        raise _refused("seed", seed, _SEEDS)
    if _NAME.fullmatch(serial) is None:
        raise _refused("serial", serial, _NAMES)


_SEEDS = "a whole number from 0 to 2^63 - 1"
_NAMES = "up to 64 letters, digits, '_', '.' and '-'; a letter or digit first"


def _refused(name: str, given: object, expected: str) -> TestloomError:
    return TestloomError(
        f"{name} cannot be '{given}'.", where=name, fault=Fault.OPERATOR, remedy=f"give {expected}."
    )
