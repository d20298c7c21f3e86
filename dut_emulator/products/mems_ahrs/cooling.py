# pyright: strict
"""The unit's thermal design: three ways of cooling, each as paper 2 simulated and as it measured it.

Seven nodes: processor, power chips (regulators, line driver), the main board about them, the gyros' area, the
area of ADC and accelerometers, what fills the housing, the case. Heat flows from chips into the board, from
board to board, through the filling and the spacers into the case, and from the case to what it stands on.

Masses make up the paper's 95 g; conductances are slabs, k A / d, of the paper's 70 × 48 × 25 mm. What the
paper does not say (powers, gaps, joints) is chosen inside the ranges below so that its figures come out:

    as simulated, 70 °C ambient:  hottest node 16, 8, 4 K above it for the schemes 1, 2, 3
    as measured,  70 °C ambient:  scheme 1 above 20 K (90 °C), near steady at 800 s;
                                  scheme 2 at most 8 K, steady at about 300 s

The two sets share powers, masses and chips. They differ in how the case stands (0.2 or 1 kW/(m² K) of a dry
or a pressed joint over its base of 33.6 cm²), in the spacers (FR4 to brass), and a little in the paste's gap.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from dut_emulator.effects.effect import FloatArray
from dut_emulator.products.mems_ahrs.thermal_network import AMBIENT, ThermalNetwork
from protocol.errors import Fault, TestloomError

NODES = ("processor", "power_chips", "board", "gyro_area", "acc_area", "filling", "case")
PROCESSOR, POWER_CHIPS, BOARD, GYRO_AREA, ACC_AREA, FILLING, CASE = range(len(NODES))

RATED_MAXIMUM_C: Mapping[str, float] = {
    "processor": 85.0,
    "power_chips": 85.0,
    "gyro_area": 80.0,
    "acc_area": 80.0,
}
"""Industrial parts; the sensors' working range of paper 2, 1.1."""


class Cooling(Enum):
    """Paper 2, 2.1.1, schemes 1 to 3."""

    AIR = 1
    PASTE = 2
    POTTED = 3


@dataclass(frozen=True)
class HousingSet:
    """What differs between the simulated and the measured unit.

    Attributes:
        case_to_ambient_w_k: joint at the base and film of air.
        spacers_w_k: the board's four spacers together.
        paste_gap_m: between chips and wall.
        schemes: that the paper has figures of.
    """

    name: str
    case_to_ambient_w_k: float
    spacers_w_k: float
    paste_gap_m: float
    schemes: tuple[Cooling, ...]


AS_SIMULATED = HousingSet("as_simulated", 0.81, 0.0513, 2.82e-3, (Cooling.AIR, Cooling.PASTE, Cooling.POTTED))
AS_MEASURED = HousingSet("as_measured", 3.57, 0.0183, 2.63e-3, (Cooling.AIR, Cooling.PASTE))

# Heat capacities, J/K: grams × J/(g K). Chips, FR4 with parts, aluminium with connector and screws: 94 g.
_CHIP_CAPACITIES = (1.5 * 0.85, 3.0 * 0.70)
_BOARD_CAPACITY, _SENSOR_AREA_CAPACITY = 6.3 * 1.1, 2.25 * 1.0
_CASE_CAPACITY = 78.0 * 0.90
_FREE_VOLUME_M3 = 55e-6
_AIR_J_M3K, _POTTING_J_M3K = 1.02e3, 2.2e6

_AIR_W_MK = 0.0322
"""Still air at 75 °C (0.030) and the radiation across the gap."""
_PASTE_W_MK = 0.8
"""White silicone grease, 0.6 to 1."""
_POTTING_W_MK = 1.87
"""Filled silicone, 1 to 3."""
_GAP_M = 4.9e-3
"""From boards to walls."""
_CHIP_AREAS_M2 = (1.96e-4, 1.2e-4)
_AREAS_M2 = (2.0e-4, 1.2e-4, 2.4e-3, 1.4e-3, 1.4e-3)
"""What each of the first five nodes shows to the filling."""
_CHIP_TO_BOARD_K_W = (9.9, 10.9)
"""Solder, vias and spreading."""
_BOARD_TO_SENSORS_K_W = (11.3, 11.6)
"""A third of a square of board with two planes of copper (36 K/W)."""


def housing(cooling: Cooling, parameters: HousingSet) -> ThermalNetwork:
    """The network of a scheme.

    Raises:
        TestloomError: the paper has no figures of this scheme in this set.
    """
    if cooling not in parameters.schemes:
        raise TestloomError(
            f"Scheme {cooling.value} was not part of the set '{parameters.name}'.",
            where="cooling of a mems_ahrs",
            fault=Fault.OPERATOR,
            remedy="take scheme 1 or 2, or the set as_simulated.",
        )
    chips = NODES[:BOARD]
    potted = cooling is Cooling.POTTED
    filling_w_mk = _POTTING_W_MK if potted else _AIR_W_MK
    half_gap = filling_w_mk / (_GAP_M / 2)
    flows = {
        **{(chip, "board"): 1 / r for chip, r in zip(chips, _CHIP_TO_BOARD_K_W, strict=True)},
        ("board", "gyro_area"): 1 / _BOARD_TO_SENSORS_K_W[0],
        ("board", "acc_area"): 1 / _BOARD_TO_SENSORS_K_W[1],
        ("board", "case"): parameters.spacers_w_k,
        **{(node, "filling"): half_gap * area for node, area in zip(NODES, _AREAS_M2, strict=False)},
        ("filling", "case"): half_gap * sum(_AREAS_M2),
        ("case", AMBIENT): parameters.case_to_ambient_w_k,
    }
    if cooling is Cooling.PASTE:
        for chip, area in zip(chips, _CHIP_AREAS_M2, strict=True):
            flows[chip, "case"] = _PASTE_W_MK * area / parameters.paste_gap_m
    capacities = (
        *_CHIP_CAPACITIES,
        _BOARD_CAPACITY,
        _SENSOR_AREA_CAPACITY,
        _SENSOR_AREA_CAPACITY,
        _FREE_VOLUME_M3 * (_POTTING_J_M3K if potted else _AIR_J_M3K),
        _CASE_CAPACITY,
    )
    return ThermalNetwork(dict(zip(NODES, capacities, strict=True)), flows)


RAIL_V = 3.3
FULL_LOAD_RATE_HZ = 200.0
_PROCESSOR_A, _GYROS_A, _ACC_AND_ADC_A, _LINE_A = 0.0788, 0.0179, 0.0172, 0.0584
"""At full load: 0.26, 0.059, 0.057 W at the rail; the line driver into its termination, at the supply."""
_IDLE_SHARE = 0.55
"""Of processor and line driver, without a stream."""


def supply_current_a(stream_rate_hz: float) -> float:
    """Drawn with a stream of this rate (0: none). The regulators are linear: it does not depend on volts."""
    load = _IDLE_SHARE + (1.0 - _IDLE_SHARE) * stream_rate_hz / FULL_LOAD_RATE_HZ
    return load * (_PROCESSOR_A + _LINE_A) + _GYROS_A + _ACC_AND_ADC_A


def heat_w(supply_v: float, stream_rate_hz: float) -> FloatArray:
    """(7,) heat of each node; nothing when the supply is off. It adds up to what is drawn."""
    heat = np.zeros(len(NODES))
    if supply_v < RAIL_V:
        return heat
    load = _IDLE_SHARE + (1.0 - _IDLE_SHARE) * stream_rate_hz / FULL_LOAD_RATE_HZ
    rail_a = load * _PROCESSOR_A + _GYROS_A + _ACC_AND_ADC_A
    heat[PROCESSOR] = RAIL_V * load * _PROCESSOR_A
    heat[GYRO_AREA], heat[ACC_AREA] = RAIL_V * _GYROS_A, RAIL_V * _ACC_AND_ADC_A
    heat[POWER_CHIPS] = (supply_v - RAIL_V) * rail_a + supply_v * load * _LINE_A
    return heat


def infrared_points_c(temperatures_c: FloatArray) -> FloatArray:
    """(n, 7) nodes → (n, 3): what an infrared thermometer sees at the paper's test points (figure 6).

    1: the hottest area, power chips and processor; 2: gyros; 3: ADC and accelerometers.
    """
    hottest = temperatures_c[:, [PROCESSOR, POWER_CHIPS]].max(axis=1)
    return np.stack([hottest, temperatures_c[:, GYRO_AREA], temperatures_c[:, ACC_AREA]], axis=1)
