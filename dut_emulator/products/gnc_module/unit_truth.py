# pyright: strict
"""What a unit really is. No unit, link or instrument says it; only the emulator's side reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from dut_emulator.effects.parameters import ZERO_MATRIX, Matrix, Triple
from protocol.gnc_module import SelfTest


class Category(StrEnum):
    """healthy: well inside every limit · near_limit: good, by a hair · marginal and gross: defective."""

    HEALTHY = "healthy"
    NEAR_LIMIT = "near_limit"
    MARGINAL = "marginal"
    GROSS = "gross"

    @property
    def is_defective(self) -> bool:
        """True if the unit is outside a limit."""
        return self in (Category.MARGINAL, Category.GROSS)


@dataclass(frozen=True)
class ElectricalTruth:
    """Resistances by name of pair (as in protocol/gnc_module.py, prefixed with the kind of test), and supply.

    `supply_lead_ohm`: between the supply's pins and the test point 5V_1.
    """

    resistance_ohm: Mapping[str, float]
    supply_lead_ohm: float
    current_running_a: float
    current_boot_a: float
    rail_3v3_v: float
    rail_1v2_v: float
    ripple_v: float


@dataclass(frozen=True)
class TriadTruth:
    """A sensor triad at the reference temperature. SI of the sensor; rows of matrices are sensors.

    `noise_density_si`: per √Hz. `turn_on_deviation_si`: of the part of the bias drawn at each power-on.
    """

    scale_factor_error: Triple
    misalignment_rad: Matrix
    bias_si: Triple
    bias_temperature_si_per_c: Triple
    turn_on_deviation_si: float
    noise_density_si: Triple
    bias_instability_si: Triple
    correlation_time_s: float
    scale_factor_temperature_per_c: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MagnetometerTruth:
    """Scale, hard iron, noise of a sample; `soft_iron` is symmetric, its diagonal is in the scale."""

    scale_factor_error: Triple
    bias_t: Triple
    noise_t: float
    soft_iron: Matrix = ZERO_MATRIX
    scale_factor_temperature_per_c: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class GnssTruth:
    """Receiver. `position_error_m`: east, north, up. Without acquisition there is no fix.

    `antenna_arm_m`: from the unit to the antenna, body axes. `multipath_m`: deviation, horizontal.
    """

    acquires: bool
    satellites_used: int
    position_error_m: Triple
    speed_error_m_s: float
    pulse_error_s: float
    latency_s: float = 0.0
    antenna_arm_m: Triple = (0.0, 0.0, 0.0)
    multipath_m: float = 0.0


@dataclass(frozen=True)
class DigitalTruth:
    """What works and what does not, apart from analogue figures.

    `wrong_addresses`: memory test → words that do not read back. `stuck_line`: IO line and its level.
    """

    wrong_addresses: Mapping[SelfTest, tuple[int, ...]] = field(
        default_factory=dict[SelfTest, tuple[int, ...]]
    )
    can_silent: bool = False
    rs422_silent: bool = False
    spi_broken: bool = False
    stuck_line: tuple[int, int] | None = None


@dataclass(frozen=True)
class UnitTruth:
    """All of a unit. `magnitude`: the affected measurand's true value in SI, or a count of what is broken.

    `crystal_error`: relative; the unit's second lasts 1 / (1 + crystal_error) s.
    `ad_error_v`, `ad_off`: by channel 1–8. `measurands`: the values the product's limits are about.
    """

    seed: int
    serial: str
    category: Category
    defect: str | None
    magnitude: float | None
    affected: tuple[str, ...]
    electrical: ElectricalTruth
    gyro: TriadTruth
    acc: TriadTruth
    magnetometer: MagnetometerTruth
    temperature_error_c: float
    self_heating_c: float
    crystal_error: float
    gnss: GnssTruth
    digital: DigitalTruth
    ad_error_v: tuple[float, ...]
    ad_off: int | None
    measurands: Mapping[str, float]

    def as_row(self) -> dict[str, Any]:
        """The row that a table of truth shows, JSON-able."""
        return {
            "serial": self.serial,
            "category": self.category.value,
            "defective": self.category.is_defective,
            "defect": self.defect,
            "magnitude": self.magnitude,
            "affected": list(self.affected),
        }
