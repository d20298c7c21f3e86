# pyright: strict
"""What units of a lot share beside their measurands: temperature coefficients, slow noise, iron, antenna.

Every parameter is mean + lot + wafer + unit (`dut_emulator.lot`), drawn apart from the measurands, and is
chosen so that none is moved beyond a limit: temperature coefficients act away from 25 °C only.

Sources: TYP typical of the sensors' class (MEMS: 50–300 ppm/°C of a gyro's, 50–200 ppm/°C of an
accelerometer's scale factor; 0.1–1 %/°C of a magnetometer's; latency of a receiver 20–200 ms) · P1 paper 1,
Table 2: bias stability of five units, 3.6 to 9.1 °/h · TL stated by this project.
"""

import dataclasses
import math
from functools import lru_cache

from dut_emulator.effects.parameters import Triple
from dut_emulator.lot import UNITS_PER_WAFER, LotDraw, Spread
from dut_emulator.products.gnc_module.product_limits import DEG, MG
from dut_emulator.products.gnc_module.unit_truth import GnssTruth, MagnetometerTruth, TriadTruth, UnitTruth

_PPM = 1e-6
_SCALE_TEMPERATURE = Spread(unit=40 * _PPM, wafer=40 * _PPM, lot=50 * _PPM)  # TYP, per °C
_BIAS_TEMPERATURE = {  # TYP: beside each unit's own 1e-3 °/s and 0.05 mg per °C
    "gyro": Spread(wafer=0.5e-3 * DEG, lot=0.5e-3 * DEG),
    "acc": Spread(wafer=0.02 * MG, lot=0.03 * MG),
}
_SLOW_NOISE = Spread(wafer=0.1, lot=0.15)  # P1: beside each unit's own 0.3, of the logarithm
_MAG_SCALE_TEMPERATURE = Spread(unit=3e-4, wafer=1e-4, lot=2e-4)  # TYP, per °C
_SOFT_IRON = Spread(unit=1e-3, wafer=0.5e-3)  # TL: the module has little iron; an installation adds more
_LATENCY_S, _LATENCY = 0.060, Spread(unit=0.003, lot=0.008)  # TYP
_ARM_M, _ARM = (0.03, 0.0, 0.08), Spread(unit=0.001)  # TL: the test board's patch antenna
_MULTIPATH_M, _MULTIPATH = 0.5, Spread(unit=0.1, lot=0.1)  # TL: under a radiating antenna


def with_lot_parts(unit: UnitTruth) -> UnitTruth:
    """The unit with these drawn."""
    draw = LotDraw(unit.seed, unit.serial)
    return dataclasses.replace(
        unit,
        gyro=_triad(unit.gyro, "gyro", draw),
        acc=_triad(unit.acc, "acc", draw),
        magnetometer=_magnetometer(unit.magnetometer, draw),
        gnss=_receiver(unit.gnss, draw),
    )


def _triad(triad: TriadTruth, sensor: str, draw: LotDraw) -> TriadTruth:
    common = _triple(draw, f"{sensor}_bias_temperature", _BIAS_TEMPERATURE[sensor])
    level = _triple(draw, f"{sensor}_bias_instability", _SLOW_NOISE)
    return dataclasses.replace(
        triad,
        scale_factor_temperature_per_c=_triple(draw, f"{sensor}_scale_temperature", _SCALE_TEMPERATURE),
        bias_temperature_si_per_c=_joined(triad.bias_temperature_si_per_c, common),
        bias_instability_si=_scaled(triad.bias_instability_si, level),
    )


def _magnetometer(truth: MagnetometerTruth, draw: LotDraw) -> MagnetometerTruth:
    xy, xz, yz = _triple(draw, "soft_iron", _SOFT_IRON)
    return dataclasses.replace(
        truth,
        soft_iron=((0.0, xy, xz), (xy, 0.0, yz), (xz, yz, 0.0)),
        scale_factor_temperature_per_c=_triple(draw, "mag_scale_temperature", _MAG_SCALE_TEMPERATURE),
    )


def _receiver(truth: GnssTruth, draw: LotDraw) -> GnssTruth:
    return dataclasses.replace(
        truth,
        latency_s=draw.normal("gnss_latency", _LATENCY_S, _LATENCY),
        antenna_arm_m=_joined(_ARM_M, draw.triple("antenna_arm", 0.0, _ARM)),
        multipath_m=draw.around("multipath", _MULTIPATH_M, _MULTIPATH),
    )


def _triple(draw: LotDraw, name: str, spread: Spread) -> Triple:
    """As `LotDraw.triple` about 0; what a wafer shares is drawn once for all of it."""
    shared = _shared(draw.seed, draw.wafer, name, spread)
    return _joined(shared, draw.triple(name, 0.0, Spread(unit=spread.unit))) if spread.unit else shared


@lru_cache(maxsize=1024)
def _shared(seed: int, wafer: int, name: str, spread: Spread) -> Triple:
    first = LotDraw(seed, str(wafer * UNITS_PER_WAFER))
    return first.triple(name, 0.0, dataclasses.replace(spread, unit=0.0))


def _joined(one: Triple, other: Triple) -> Triple:
    x, y, z = (a + b for a, b in zip(one, other, strict=True))
    return x, y, z


def _scaled(values: Triple, logarithms: Triple) -> Triple:
    x, y, z = (value * math.exp(power) for value, power in zip(values, logarithms, strict=True))
    return x, y, z
