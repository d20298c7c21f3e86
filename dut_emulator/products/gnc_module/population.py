# pyright: strict
"""A lot: each unit's truth, drawn from stated distributions by lot seed and serial alone.

A unit begins as a table of measurands, one for each of the product's limits, drawn so that every one lies
well inside. Near-limit and defective units have one of them moved by the same rule for all; defects that
are no matter of degree (a silent bus, a dead axis) are set on the finished unit. So whichever bench is
given seed and serial makes the same unit, in whatever order.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from dut_emulator.products.gnc_module.defects import (
    DEFECTS,
    NEAR_LIMIT_MEASURANDS,
    DefectKind,
    DefectNote,
    break_unit,
    with_consequences,
)
from dut_emulator.products.gnc_module.lot_parts import with_lot_parts
from dut_emulator.products.gnc_module.product_limits import (
    DEG,
    GROSS_WIDTHS,
    MARGINAL_WIDTHS,
    MG,
    NEAR_LIMIT_FROM_U,
    NEAR_LIMIT_TO_U,
    PRODUCT_LIMITS,
)
from dut_emulator.products.gnc_module.unit_truth import (
    Category,
    DigitalTruth,
    ElectricalTruth,
    GnssTruth,
    MagnetometerTruth,
    TriadTruth,
    UnitTruth,
)
from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS, SUPPLY_CURRENT_NOMINAL_A

GROSS_SHARE, MARGINAL_SHARE, NEAR_LIMIT_SHARE = 0.15, 0.07, 0.10
"""Probabilities of the categories; the rest is healthy."""

SAMPLE_RATE_OF_NOISE_LIMITS_HZ = 200.0
"""The noise measurands are standard deviations of samples at this rate."""

_DEG_PER_HOUR = DEG / 3600
GYRO_TURN_ON_SI, ACC_TURN_ON_SI = 3 * _DEG_PER_HOUR, 0.04 * MG
"""Bias repeatability: means of the five units of paper 1, Table 2."""
_AXES = "xyz"
_COUPLINGS = ("xy", "xz", "yx", "yz", "zx", "zy")


def draw_unit(seed: int, serial: str) -> UnitTruth:
    """The truth of a unit of a lot. Depends on nothing but the two arguments."""
    rng = np.random.Generator(np.random.PCG64(unit_seed(seed, serial, 0)))
    measurands = _healthy_measurands(rng)
    category = _draw_category(rng)
    note = DefectNote(None, None, ())
    kind: DefectKind | None = None
    if category is Category.NEAR_LIMIT:
        name, side = NEAR_LIMIT_MEASURANDS[int(rng.integers(len(NEAR_LIMIT_MEASURANDS)))]
        distance = rng.uniform(NEAR_LIMIT_FROM_U, NEAR_LIMIT_TO_U)
        measurands[name] = PRODUCT_LIMITS[name].inside(float(distance), side)
        note = DefectNote(None, measurands[name], (name,))
    elif category.is_defective:
        kinds = [kind for kind in DEFECTS if category is Category.GROSS or kind.can_be_marginal]
        kind = kinds[int(rng.integers(len(kinds)))]
        if kind.measurands:
            note = _move_beyond(measurands, kind, category, rng)
    unit = _assemble(seed, serial, category, note, measurands, rng)
    return with_consequences(break_unit(unit, kind, rng)) if kind is not None else unit


def truth_table(seed: int, serials: Iterable[str]) -> list[dict[str, Any]]:
    """The truth of some units, JSON-able, for the end of a run; no station sees it."""
    return [draw_unit(seed, serial).as_row() for serial in serials]


def unit_seed(seed: int, serial: str, *purpose: int) -> np.random.SeedSequence:
    """The seed of one of a unit's random processes; different purposes are independent."""
    return np.random.SeedSequence([seed % 2**64, *serial.encode()], spawn_key=purpose)


def _draw_category(rng: np.random.Generator) -> Category:
    at = float(rng.random())
    for category, share in (
        (Category.GROSS, GROSS_SHARE),
        (Category.MARGINAL, MARGINAL_SHARE),
        (Category.NEAR_LIMIT, NEAR_LIMIT_SHARE),
    ):
        if at < share:
            return category
        at -= share
    return Category.HEALTHY


def _move_beyond(
    measurands: dict[str, float], kind: DefectKind, category: Category, rng: np.random.Generator
) -> DefectNote:
    name, side = kind.measurands[int(rng.integers(len(kind.measurands)))]
    if category is Category.GROSS and kind.gross_value is not None:
        value = kind.gross_value
    else:
        widths = GROSS_WIDTHS if category is Category.GROSS else MARGINAL_WIDTHS
        value = PRODUCT_LIMITS[name].beyond(widths, side)
        if PRODUCT_LIMITS[name].low is None or PRODUCT_LIMITS[name].high is None:
            value = max(value, 0.0)
    measurands[name] = value
    return DefectNote(kind.name, value, (name,))


def _normal(rng: np.random.Generator, mean: float, deviation: float, cut: float) -> float:
    """Normal, cut (not redrawn: one draw each keeps the order fixed) at mean ± cut."""
    return float(mean + np.clip(deviation * rng.standard_normal(), -cut, cut))


def _around(rng: np.random.Generator, median: float, log_deviation: float, log_cut: float) -> float:
    """Log-normal about the median."""
    return median * math.exp(_normal(rng, 0.0, log_deviation, log_cut))


def _healthy_measurands(rng: np.random.Generator) -> dict[str, float]:
    """Every measurand at least `HEALTHY_MARGIN_U` standard uncertainties inside its limits."""
    values: dict[str, float] = {}
    for pair in CONTINUITY_PAIRS:
        values[f"continuity_{pair.name}"] = _around(rng, pair.nominal_ohm, 0.12, 0.36)
    for pair in INSULATION_PAIRS:
        values[f"insulation_{pair.name}"] = _around(rng, pair.nominal_ohm, 0.3, 0.9)
    for pair in IMPEDANCE_PAIRS:
        values[f"impedance_{pair.name}"] = _around(rng, pair.nominal_ohm, 0.06, 0.18)
    values["supply_current"] = _normal(rng, SUPPLY_CURRENT_NOMINAL_A, 4e-3, 14e-3)
    values["rail_3v3"] = _normal(rng, 3.3, 13e-3, 50e-3)
    values["rail_1v2"] = _normal(rng, 1.2, 5e-3, 20e-3)
    values["ripple_5v"] = _around(rng, 18e-3, 0.15, 0.45)
    values["timer_period_error"] = _normal(rng, 0.0, 15e-6, 50e-6)
    values["gnss_position_error"] = float(np.clip(rng.rayleigh(3.0), 0.3, 9.0))
    values["gnss_speed"] = float(np.clip(rng.rayleigh(0.02), 0.0, 0.08))
    values["gnss_pulse_error"] = _normal(rng, 0.0, 15e-9, 45e-9)
    for channel in range(4, 9):
        values[f"ad_error_{channel}"] = _normal(rng, 0.0, 2.5e-3, 8e-3)
    for axis in _AXES:
        values[f"gyro_bias_{axis}"] = _normal(rng, 0.0, 0.2 * DEG, 0.6 * DEG)
        values[f"gyro_scale_factor_error_{axis}"] = _normal(rng, 0.0, 4e-3, 12e-3)
        values[f"gyro_noise_{axis}"] = _around(rng, 0.047 * DEG, 0.15, 0.45)  # 0.2 °/√h
        values[f"acc_bias_{axis}"] = _normal(rng, 0.0, 4 * MG, 12 * MG)
        values[f"acc_scale_factor_error_{axis}"] = _normal(rng, 0.0, 3e-3, 9e-3)
        values[f"acc_noise_{axis}"] = _around(rng, 1.2 * MG, 0.15, 0.45)  # 0.05 m/s/√h
    for pair_of_axes in _COUPLINGS:
        values[f"gyro_coupling_{pair_of_axes}"] = _normal(rng, 0.0, 3e-3, 9e-3)
        values[f"acc_coupling_{pair_of_axes}"] = _normal(rng, 0.0, 3e-3, 9e-3)
    return values


def _assemble(
    seed: int,
    serial: str,
    category: Category,
    note: DefectNote,
    values: dict[str, float],
    rng: np.random.Generator,
) -> UnitTruth:
    resistances = {
        name: value
        for name, value in values.items()
        if name.startswith(("continuity_", "insulation_", "impedance_"))
    }
    electrical = ElectricalTruth(
        resistance_ohm=resistances,
        supply_lead_ohm=_around(rng, 0.02, 0.1, 0.3),
        current_running_a=values["supply_current"],
        current_boot_a=0.65 * values["supply_current"],
        rail_3v3_v=values["rail_3v3"],
        rail_1v2_v=values["rail_1v2"],
        ripple_v=values["ripple_5v"],
    )
    gyro = dataclasses.replace(
        _triad(values, "gyro", rng, temperature_si_per_c=1e-3 * DEG),
        turn_on_deviation_si=GYRO_TURN_ON_SI,
        bias_instability_si=_three(_around(rng, 5 * _DEG_PER_HOUR, 0.3, 0.9) for _ in _AXES),
    )
    acc = dataclasses.replace(
        _triad(values, "acc", rng, temperature_si_per_c=0.05 * MG),
        turn_on_deviation_si=ACC_TURN_ON_SI,
        bias_instability_si=_three(_around(rng, 0.1 * MG, 0.3, 0.9) for _ in _AXES),
    )
    unit = UnitTruth(
        seed=seed,
        serial=serial,
        category=category,
        defect=note.defect,
        magnitude=note.magnitude,
        affected=note.affected,
        electrical=electrical,
        gyro=gyro,
        acc=acc,
        magnetometer=MagnetometerTruth(
            scale_factor_error=_three(_normal(rng, 0.0, 0.01, 0.03) for _ in _AXES),
            bias_t=_three(_normal(rng, 0.0, 5e-6, 15e-6) for _ in _AXES),
            noise_t=5e-8,
        ),
        temperature_error_c=_normal(rng, 0.0, 0.5, 1.5),
        self_heating_c=_around(rng, 2.0, 0.1, 0.3),
        # a longer period is a slower crystal
        crystal_error=1 / (1 + values["timer_period_error"]) - 1,
        gnss=_gnss(values, rng),
        digital=DigitalTruth(),
        ad_error_v=(0.0, 0.0, 0.0, *(values[f"ad_error_{channel}"] for channel in range(4, 9))),
        ad_off=None,
        measurands=dict(values),
    )
    return with_lot_parts(unit)


def _triad(
    values: dict[str, float], sensor: str, rng: np.random.Generator, temperature_si_per_c: float
) -> TriadTruth:
    density = 1 / math.sqrt(SAMPLE_RATE_OF_NOISE_LIMITS_HZ)
    return TriadTruth(
        scale_factor_error=_three(values[f"{sensor}_scale_factor_error_{axis}"] for axis in _AXES),
        misalignment_rad=_three(
            _three(0.0 if row == column else values[f"{sensor}_coupling_{row}{column}"] for column in _AXES)
            for row in _AXES
        ),
        bias_si=_three(values[f"{sensor}_bias_{axis}"] for axis in _AXES),
        bias_temperature_si_per_c=_three(
            _normal(rng, 0.0, temperature_si_per_c, 3 * temperature_si_per_c) for _ in _AXES
        ),
        turn_on_deviation_si=0.0,
        noise_density_si=_three(density * values[f"{sensor}_noise_{axis}"] for axis in _AXES),
        bias_instability_si=(0.0, 0.0, 0.0),
        correlation_time_s=300.0,
    )


def _gnss(values: dict[str, float], rng: np.random.Generator) -> GnssTruth:
    direction = rng.standard_normal(3)
    error = values["gnss_position_error"] * direction / np.linalg.norm(direction)
    east, north, up = (float(component) for component in error)
    return GnssTruth(
        acquires=True,
        satellites_used=int(rng.integers(9, 15)),
        position_error_m=(east, north, up),
        speed_error_m_s=values["gnss_speed"],
        pulse_error_s=values["gnss_pulse_error"],
    )


def _three(values: Iterable[Any]) -> Any:
    x, y, z = values
    return (x, y, z)
