# pyright: strict
"""What can be wrong with a unit, from gross to marginal.

A defect that is a matter of degree moves a measurand beyond one of its limits: half a width if marginal,
three widths (or `gross_value`) if gross. One that is not (`break_unit`) is always gross.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.deterministic import Triple
from dut_emulator.products.gnc_module.unit_truth import TriadTruth, UnitTruth
from protocol.gnc_module import (
    CONTINUITY_PAIRS,
    IMPEDANCE_PAIRS,
    INSULATION_PAIRS,
    OPEN_CIRCUIT_OHM,
    SelfTest,
)

LOW, HIGH = -1, 1
Side = tuple[str, int]
"""A measurand and the limit of it that is passed."""

_AXES = ("x", "y", "z")
MEMORY_WORDS = {
    SelfTest.INTERNAL_RAM: 51_200,
    SelfTest.SDRAM: 1_048_576,
    SelfTest.SPI_FLASH: 262_144,
    SelfTest.INTERNAL_FLASH: 131_072,
}
"""Words that each memory test covers (16-bit words)."""
MAX_WRONG_WORDS = 16
"""A bad cell takes its row's neighbours with it, up to so many."""


@dataclass(frozen=True)
class DefectNote:
    """What the table of truth says of a defect."""

    defect: str | None
    magnitude: float | None
    affected: tuple[str, ...]


@dataclass(frozen=True)
class DefectKind:
    """A kind of defect. `measurands`: those it may move (one of them, drawn); empty: see `break_unit`."""

    name: str
    measurands: tuple[Side, ...] = ()
    gross_value: float | None = None
    can_be_marginal: bool = True


def _all(prefix: str, names: tuple[str, ...], *sides: int) -> tuple[Side, ...]:
    return tuple((f"{prefix}_{name}", side) for name in names for side in sides)


_IMPEDANCES = tuple(pair.name for pair in IMPEDANCE_PAIRS)

DEFECTS = (
    DefectKind(
        "open_pin", _all("continuity", tuple(p.name for p in CONTINUITY_PAIRS), HIGH), OPEN_CIRCUIT_OHM
    ),
    DefectKind("shorted_pin", _all("insulation", tuple(p.name for p in INSULATION_PAIRS), LOW), 3.0),
    DefectKind("shorted_rail", _all("impedance", _IMPEDANCES, LOW), 2.0, can_be_marginal=False),
    DefectKind("high_impedance_rail", _all("impedance", _IMPEDANCES, HIGH)),
    DefectKind("weak_rail", (("rail_3v3", LOW), ("rail_1v2", LOW))),
    DefectKind("excess_ripple", (("ripple_5v", HIGH),)),
    DefectKind("high_supply_current", (("supply_current", HIGH),)),
    DefectKind("slow_timer", (("timer_period_error", HIGH),)),
    DefectKind("gyro_scale", _all("gyro_scale_factor_error", _AXES, LOW, HIGH)),
    DefectKind("gyro_bias", _all("gyro_bias", _AXES, LOW, HIGH)),
    DefectKind("noisy_gyro", _all("gyro_noise", _AXES, HIGH)),
    DefectKind("acc_bias", _all("acc_bias", ("x", "y"), LOW, HIGH)),
    DefectKind("ad_error", _all("ad_error", ("4", "5", "6"), LOW, HIGH)),
    DefectKind("gnss_position", (("gnss_position_error", HIGH),)),
    DefectKind("dead_gyro_axis", can_be_marginal=False),
    DefectKind("bad_memory_cell", can_be_marginal=False),
    DefectKind("silent_can", can_be_marginal=False),
    DefectKind("no_gnss_fix", can_be_marginal=False),
    DefectKind("io_stuck", can_be_marginal=False),
    DefectKind("spi_broken", can_be_marginal=False),
    DefectKind("ad_channel_off", can_be_marginal=False),
)
NEAR_LIMIT_MEASURANDS = (
    *(side for kind in DEFECTS if kind.can_be_marginal for side in kind.measurands),
    ("supply_current", LOW),
    ("rail_3v3", HIGH),
    ("rail_1v2", HIGH),
    ("timer_period_error", LOW),
)
"""Every measurand that a defect can move can also lie just inside its limit."""


def break_unit(unit: UnitTruth, kind: DefectKind, rng: np.random.Generator) -> UnitTruth:
    """The unit with a defect that is no matter of degree; others are in its measurands already."""
    if kind.measurands:
        return unit
    broken, note = _BREAKERS[kind.name](unit, rng)
    return dataclasses.replace(broken, defect=note.defect, magnitude=note.magnitude, affected=note.affected)


SHORT_OHM = 100.0
"""A bus pin tied to something by less than this carries no signal."""


def with_consequences(unit: UnitTruth) -> UnitTruth:
    """The unit with what an open link between its layers, or a shorted bus pin, takes with it."""
    circuit = unit.electrical.resistance_ohm
    digital, gnss, gyro, acc = unit.digital, unit.gnss, unit.gyro, unit.acc
    if min(circuit["insulation_can_to_5v"], circuit["insulation_can_to_ground"]) < SHORT_OHM:
        digital = dataclasses.replace(digital, can_silent=True)
    if min(circuit["insulation_rs422_to_5v"], circuit["insulation_rs422_to_ground"]) < SHORT_OHM:
        digital = dataclasses.replace(digital, rs422_silent=True)
    if circuit["continuity_layer_link_spi"] >= OPEN_CIRCUIT_OHM:
        wrong = {SelfTest.SPI_FLASH: tuple(range(MAX_WRONG_WORDS))}
        digital = dataclasses.replace(digital, wrong_addresses=wrong)
    if circuit["continuity_layer_link_gnss"] >= OPEN_CIRCUIT_OHM:
        gnss = dataclasses.replace(gnss, acquires=False, satellites_used=0)
    if circuit["continuity_layer_link_imu"] >= OPEN_CIRCUIT_OHM:
        for axis in range(3):
            gyro, acc = _silenced(gyro, axis), _silenced(acc, axis)
    return dataclasses.replace(unit, digital=digital, gnss=gnss, gyro=gyro, acc=acc)


def _dead_gyro_axis(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:
    axis = int(rng.integers(3))
    gyro = _silenced(unit.gyro, axis)
    return dataclasses.replace(unit, gyro=gyro), DefectNote(
        "dead_gyro_axis", -1.0, (f"gyro_scale_factor_error_{_AXES[axis]}", f"gyro_noise_{_AXES[axis]}")
    )


def _silenced(triad: TriadTruth, axis: int) -> TriadTruth:
    """The triad with one sensor that says zero, whatever happens."""

    def set_axis(values: Triple, value: float) -> Triple:
        x, y, z = (value if i == axis else v for i, v in enumerate(values))
        return (x, y, z)

    return dataclasses.replace(
        triad,
        scale_factor_error=set_axis(triad.scale_factor_error, -1.0),
        bias_si=set_axis(triad.bias_si, 0.0),
        bias_temperature_si_per_c=set_axis(triad.bias_temperature_si_per_c, 0.0),
        noise_density_si=set_axis(triad.noise_density_si, 0.0),
        bias_instability_si=set_axis(triad.bias_instability_si, 0.0),
    )


def _bad_memory_cell(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:
    memory = list(MEMORY_WORDS)[int(rng.integers(len(MEMORY_WORDS)))]
    count = int(rng.integers(1, MAX_WRONG_WORDS + 1))
    first = int(rng.integers(MEMORY_WORDS[memory] - MAX_WRONG_WORDS))
    digital = dataclasses.replace(unit.digital, wrong_addresses={memory: tuple(range(first, first + count))})
    return dataclasses.replace(unit, digital=digital), DefectNote(
        "bad_memory_cell", float(count), (f"{memory.name.lower()}_words_wrong",)
    )


def _silent_can(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:  # noqa: ARG001
    digital = dataclasses.replace(unit.digital, can_silent=True)
    return dataclasses.replace(unit, digital=digital), DefectNote("silent_can", 1.0, ("can",))


def _no_gnss_fix(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:
    satellites = int(rng.integers(0, 4))
    gnss = dataclasses.replace(unit.gnss, acquires=False, satellites_used=satellites)
    note = DefectNote("no_gnss_fix", float(satellites), ("gnss_fix", "gnss_satellites"))
    return dataclasses.replace(unit, gnss=gnss), note


def _io_stuck(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:
    line, level = int(rng.integers(4)), int(rng.integers(2))
    digital = dataclasses.replace(unit.digital, stuck_line=(line, level))
    return dataclasses.replace(unit, digital=digital), DefectNote("io_stuck", float(line), ("io", "spi"))


def _spi_broken(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:  # noqa: ARG001
    digital = dataclasses.replace(unit.digital, spi_broken=True)
    return dataclasses.replace(unit, digital=digital), DefectNote("spi_broken", 1.0, ("spi",))


def _ad_channel_off(unit: UnitTruth, rng: np.random.Generator) -> tuple[UnitTruth, DefectNote]:
    # channels 7 and 8 read 0 V in a good unit too, 1 to 3 hardly more
    channel = int(rng.integers(4, 7))
    note = DefectNote("ad_channel_off", float(channel), (f"ad_error_{channel}",))
    return dataclasses.replace(unit, ad_off=channel), note


_BREAKERS: dict[str, Callable[[UnitTruth, np.random.Generator], tuple[UnitTruth, DefectNote]]] = {
    "dead_gyro_axis": _dead_gyro_axis,
    "bad_memory_cell": _bad_memory_cell,
    "silent_can": _silent_can,
    "no_gnss_fix": _no_gnss_fix,
    "io_stuck": _io_stuck,
    "spi_broken": _spi_broken,
    "ad_channel_off": _ad_channel_off,
}
