# pyright: strict
"""The unit as a circuit: resistances between test points, rails and current by state. Thin on purpose.

Out of scope: inrush, load steps, contact resistance (the socket board's) and anything but DC and ripple.
"""

import math

from dut_emulator.products.gnc_module.unit_truth import ElectricalTruth
from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS, OPEN_CIRCUIT_OHM

TURN_ON_V, BROWN_OUT_V = 4.3, 4.0
"""The unit starts above the one and is off below the other."""
LEAKAGE_A = 0.5e-3
"""Drawn below brown-out."""
REGULATOR_LIMIT_A = 3.0
"""Each converter's limit (paper 1, section 1)."""
REGULATOR_EFFICIENCY = 0.85
REGULATOR_DROP_V = 0.3
FAULT_OHM = 50.0
"""A rail to ground below this is a fault that draws current; above, semiconductors that do not at DC."""

_NAME_OF_PAIR = {
    frozenset((pair.high, pair.low)): f"{kind}_{pair.name}"
    for kind, pairs in (
        ("continuity", CONTINUITY_PAIRS),
        ("insulation", INSULATION_PAIRS),
        ("impedance", IMPEDANCE_PAIRS),
    )
    for pair in pairs
}


def resistance_ohm(truth: ElectricalTruth, high: str, low: str) -> float:
    """Between two test points, unpowered, in either order; pairs that the product does not name are open."""
    if high == low:
        return 0.0
    name = _NAME_OF_PAIR.get(frozenset((high, low)))
    value = truth.resistance_ohm[name] if name is not None else math.inf
    return math.inf if value >= OPEN_CIRCUIT_OHM else value


def _fault_current_a(voltage_v: float, resistance: float) -> float:
    return voltage_v / resistance if resistance < FAULT_OHM else 0.0


def rail_v(truth: ElectricalTruth, rail: str, supply_v: float, running_a: float) -> float:
    """DC voltage of a rail ('5V', '3V3', '1V2'). Converters hold until `REGULATOR_LIMIT_A`."""
    if rail == "5V":
        return supply_v - truth.supply_lead_ohm * supply_current_a(truth, supply_v, running_a)
    if running_a == 0.0:
        return 0.0
    nominal = truth.rail_3v3_v if rail == "3V3" else truth.rail_1v2_v
    to_ground = truth.resistance_ohm[f"impedance_rail_{rail.lower()}"]
    held = REGULATOR_LIMIT_A * to_ground if to_ground < FAULT_OHM else math.inf
    return max(0.0, min(nominal, supply_v - REGULATOR_DROP_V, held))


def supply_current_a(truth: ElectricalTruth, supply_v: float, running_a: float) -> float:
    """Drawn from the supply: `running_a` of the unit's state, and what faults draw."""
    if supply_v <= 0.0:
        return 0.0
    total = running_a if running_a > 0.0 else LEAKAGE_A
    total += _fault_current_a(supply_v, truth.resistance_ohm["impedance_supply_5v"])
    for rail in ("3V3", "1V2"):
        volts = rail_v(truth, rail, supply_v, running_a)
        drawn = _fault_current_a(volts, truth.resistance_ohm[f"impedance_rail_{rail.lower()}"])
        total += drawn * volts / (supply_v * REGULATOR_EFFICIENCY)
    return total
