# pyright: strict
"""The product's limits as the emulator knows them, and where a value lies with respect to them.

Emulator and plans must agree and share no code: a fault of reading would otherwise cancel itself. So
these are the emulator's own; a test holds them against the plans. `standard_uncertainty` is what a bench
of the kind in docs/bench.md can be expected to have, and decides only how near 'near_limit' is.

Sources: P1T3 paper 1, Table 3 · P1S4 paper 1, section 4.1 (functional test) · TL stated by this project where
the paper is silent.
"""

import math
from dataclasses import dataclass

from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

DEG = math.pi / 180
MG = 1e-3 * STANDARD_GRAVITY_M_S2

NEAR_LIMIT_FROM_U, NEAR_LIMIT_TO_U = 1.0, 4.0
"""A near-limit unit lies this many standard uncertainties inside one limit."""
HEALTHY_MARGIN_U = 6.0
"""A healthy unit lies at least this many standard uncertainties inside every limit."""
MARGINAL_WIDTHS = 0.5
"""A marginal defect lies this many limit widths beyond one limit."""
GROSS_WIDTHS = 3.0
"""A gross defect that is a matter of degree lies this many limit widths beyond."""


@dataclass(frozen=True)
class ProductLimit:
    """Limits of one measurand, SI; a missing side is open.

    The width is high − low. With one side open it is the limit's own magnitude: the distance to zero.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    standard_uncertainty: float
    source: str

    @property
    def width(self) -> float:
        """The limits' width, by the rule above."""
        if self.low is not None and self.high is not None:
            return self.high - self.low
        return abs(self.low if self.low is not None else self.high or 0.0)

    def beyond(self, widths: float, side: int) -> float:
        """The value so many widths beyond the low (side < 0) or high limit; negative: inside."""
        limit = self.low if side < 0 else self.high
        assert limit is not None, f"{self.name} has no limit on side {side}"
        return limit + math.copysign(widths * self.width, side)

    def inside(self, uncertainties: float, side: int) -> float:
        """The value so many standard uncertainties inside the limit of that side."""
        limit = self.low if side < 0 else self.high
        assert limit is not None, f"{self.name} has no limit on side {side}"
        return limit - math.copysign(uncertainties * self.standard_uncertainty, side)

    def margin_u(self, value: float) -> float:
        """Distance to the nearer limit in standard uncertainties; negative outside."""
        distance = min(
            value - self.low if self.low is not None else math.inf,
            self.high - value if self.high is not None else math.inf,
        )
        return distance / self.standard_uncertainty


def _about(nominal: float, relative: float) -> tuple[float, float]:
    return nominal * (1 - relative), nominal * (1 + relative)


def _symmetric(prefix: str, names: str, unit: str, bound: float, u: float, source: str) -> list[ProductLimit]:
    return [ProductLimit(f"{prefix}_{name}", unit, -bound, bound, u, source) for name in names.split()]


_IMPEDANCE_OHM = {"supply_5v": (500.0, 5000.0), "rail_3v3": (200.0, 3000.0), "rail_1v2": (50.0, 1000.0)}
_COUPLINGS = "xy xz yx yz zx zy"

_TABLE = (
    *(ProductLimit(f"continuity_{p.name}", "ohm", None, 1.0, 0.01, "TL") for p in CONTINUITY_PAIRS),
    *(ProductLimit(f"insulation_{p.name}", "ohm", 20e6, None, 0.4e6, "TL") for p in INSULATION_PAIRS),
    *(
        ProductLimit(f"impedance_{p.name}", "ohm", *_IMPEDANCE_OHM[p.name], 2e-3 * p.nominal_ohm, "TL")
        for p in IMPEDANCE_PAIRS
    ),
    ProductLimit("supply_voltage", "V", *_about(5.0, 0.05), 2e-3, "P1T3"),
    ProductLimit("supply_current", "A", *_about(0.49, 0.05), 5e-4, "P1T3"),
    ProductLimit("rail_3v3", "V", *_about(3.3, 0.05), 1e-3, "TL"),
    ProductLimit("rail_1v2", "V", *_about(1.2, 0.05), 5e-4, "TL"),
    ProductLimit("ripple_5v", "V", None, 0.050, 5e-4, "TL"),
    ProductLimit("timer_period_error", "1", -200e-6, 200e-6, 20e-6, "TL"),
    ProductLimit("gnss_position_error", "m", None, 15.0, 0.5, "P1T3"),
    ProductLimit("gnss_speed", "m/s", None, 0.2, 0.01, "P1T3"),
    # Table 3 asks for 10 ns, below what a bench without a time standard can tell
    ProductLimit("gnss_pulse_error", "s", -100e-9, 100e-9, 5e-9, "TL"),
    *_symmetric("ad_error", "4 5 6 7 8", "V", 0.020, 1e-3, "TL"),
    *_symmetric("gyro_bias", "x y z", "rad/s", 1.0 * DEG, 0.006 * DEG, "TL"),
    *(
        ProductLimit(f"gyro_noise_{axis}", "rad/s", None, 0.15 * DEG, 0.008 * DEG, "TL")
        for axis in ("x", "y", "z")
    ),
    *(ProductLimit(f"acc_noise_{axis}", "m/s^2", None, 10 * MG, 0.5 * MG, "TL") for axis in ("x", "y", "z")),
    # the board is level and the unit lies flat: |norm − g| sees bias and scale of z to first order
    ProductLimit("acc_norm_error", "m/s^2", -30 * MG, 30 * MG, 0.3 * MG, "TL"),
    *_symmetric("gyro_scale_factor_error", "x y z", "1", 0.02, 5e-5, "TL"),
    *_symmetric("gyro_coupling", _COUPLINGS, "rad", 0.02, 1e-4, "TL"),
    *_symmetric("acc_bias", "x y z", "m/s^2", 30 * MG, 0.15 * MG, "TL"),
    *_symmetric("acc_scale_factor_error", "x y z", "1", 0.02, 2e-4, "TL"),
    *_symmetric("acc_coupling", _COUPLINGS, "rad", 0.02, 2e-4, "TL"),
)
PRODUCT_LIMITS = {limit.name: limit for limit in _TABLE}
"""Measurand → limits. Beside these: memory words wrong = 0, echoes and patterns without error, a
three-dimensional fix with at least `GNSS_SATELLITES_MIN` satellites."""

GNSS_SATELLITES_MIN = 6
