# pyright: strict
"""Records of attitude tests: the swing's lag and error, the 1 sigma of each phase of a flight (paper 2)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.attitude_error_figures import OVERALL, ErrorFigure
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.swing import SwingResult
from calibration.records.making import RecordContent, covariance_block, coverage_factor
from calibration.records.record import COVERAGE_PROBABILITY
from calibration.records.record_parts import (
    CalibratedQuantity,
    CovarianceBlock,
    Interval,
    Model,
    RecordedBudget,
    RecordedBudgetRow,
    RecordTable,
    TableColumn,
)

LAG, LAG_AND_OFFSET, CLOCK_DRIFT = "lag", "lag_and_clock_offset", "clock_drift"
SWING_EQUATION = "y(t) = c + (1 + s) theta(t - tau - d t) + e(t)"
MOST_ROWS = 600
MIN_INDEPENDENT_SAMPLES = 5.0
"""Below, a 1 sigma is so lopsided that a standard uncertainty says nothing."""


@dataclass(frozen=True)
class LagContribution:
    """Something that looks like a lag: `standard_uncertainty` in `unit`, `sensitivity` in s over it."""

    quantity: str
    unit: str
    standard_uncertainty: float
    sensitivity: float


def swing_content(
    result: SwingResult,
    contributions: Sequence[LagContribution],
    triggered: bool,
    tables: Sequence[RecordTable] = (),
) -> RecordContent:
    """Lag (with the clocks' offset where nothing joins them), scale factor error, attitude error left."""
    name, symbol = (LAG, "tau") if triggered else (LAG_AND_OFFSET, "tau_o")
    freedom = float(result.cycles - 2)
    budget = RecordedBudget(result=name, rows=_lag_rows(result, contributions, freedom))
    drift = _of_t(math.sqrt(float(result.covariance[1, 1])), freedom)
    scale = _of_t(math.sqrt(float(result.covariance[2, 2])), freedom)
    return RecordContent(
        method="swing",
        model=Model(name="swing" if triggered else "swing_clocks_apart", equation=SWING_EQUATION),
        quantities=(
            CalibratedQuantity(
                name=name,
                symbol=symbol,
                value=result.lag_s,
                unit="s",
                standard_uncertainty=budget.standard_uncertainty,
            ),
            CalibratedQuantity(
                name=CLOCK_DRIFT,
                symbol="d",
                value=result.clock_drift,
                unit="1",
                standard_uncertainty=drift,
            ),
            CalibratedQuantity(
                name="scale_factor_error",
                symbol="s",
                value=result.scale_factor_error,
                unit="1",
                standard_uncertainty=scale,
            ),
            sigma_quantity("attitude_error", "sigma_e", result.error),
        ),
        covariance=(_covariance(name, result, budget.standard_uncertainty, freedom),),
        budgets=(budget,),
        tables=(
            RecordTable(
                name="cycles",
                columns=(
                    _column("time", "s", result.cycle_time_s),
                    _column(name, "s", result.lag_of_cycle_s),
                ),
            ),
            *tables,
        ),
    )


def _lag_rows(
    result: SwingResult, contributions: Sequence[LagContribution], freedom: float
) -> tuple[RecordedBudgetRow, ...]:
    return (
        RecordedBudgetRow(
            quantity="scatter of the cycles",
            estimate=result.lag_s,
            unit="s",
            standard_uncertainty=_of_t(result.lag_scatter_uncertainty_s, freedom),
            distribution="t",
            sensitivity=1.0,
            degrees_of_freedom=freedom,
        ),
        *(
            RecordedBudgetRow(
                quantity=one.quantity,
                estimate=0.0,
                unit=one.unit,
                standard_uncertainty=one.standard_uncertainty,
                distribution="normal",
                sensitivity=one.sensitivity,
            )
            for one in contributions
        ),
    )


def _of_t(uncertainty: float, freedom: float) -> float:
    """Standard deviation of the t distribution (JCGM 101:2008, 6.4.9.2); of two degrees: as of three."""
    return uncertainty * math.sqrt(max(freedom, 3.0) / (max(freedom, 3.0) - 2.0))


def _covariance(name: str, result: SwingResult, of_lag: float, freedom: float) -> CovarianceBlock:
    matrix = result.covariance * _of_t(1.0, freedom) ** 2
    matrix[0, 0] = of_lag**2
    return covariance_block((name, CLOCK_DRIFT, "scale_factor_error"), matrix)


def sigma_quantity(
    name: str, symbol: str, figure: ErrorFigure, of_reference: float = 0.0
) -> CalibratedQuantity:
    """A 1 sigma with the interval that its independent samples leave; where they are few, that alone."""
    lower, upper = figure.interval(COVERAGE_PROBABILITY, of_reference)
    nu = figure.independent_samples
    enough = nu >= MIN_INDEPENDENT_SAMPLES
    return CalibratedQuantity(
        name=name,
        symbol=symbol,
        value=figure.sigma,
        unit="rad",
        standard_uncertainty=figure.standard_uncertainty(of_reference) if enough else None,
        degrees_of_freedom=nu if enough else None,
        coverage_factor=coverage_factor(nu if enough else None),
        interval=Interval(lower=lower, upper=upper, probability=COVERAGE_PROBABILITY),
    )


def attitude_content(
    roll: Mapping[str, ErrorFigure],
    pitch: Mapping[str, ErrorFigure],
    of_reference_rad: float,
    numbers: Mapping[str, int],
    tables: Sequence[RecordTable],
    computed_here: bool = False,
) -> RecordContent:
    """1 sigma of roll and pitch, overall first, then phase by phase.

    `numbers`: of phases, as drawn; `computed_here`: the attitude is our strapdown algorithm's.
    """
    phases = [OVERALL, *(name for name in roll if name != OVERALL)]
    quantities = [
        sigma_quantity(f"{angle}_error_{phase}", "", figures[phase], of_reference_rad)
        for phase in phases
        for angle, figures in (("roll", roll), ("pitch", pitch))
    ]
    rows = [(angle, phase, figures[phase]) for phase in phases for angle, figures in _both(roll, pitch)]
    by_phase = RecordTable(
        name="errors_by_phase",
        row_names=tuple(f"{angle}, {_numbered(phase, numbers)}" for angle, phase, _ in rows),
        columns=(
            _column("rms", "rad", [one.sigma for _, _, one in rows]),
            _column("mean", "rad", [one.mean for _, _, one in rows]),
            _column("largest", "rad", [one.largest for _, _, one in rows]),
            _column("independent_samples", "1", [one.independent_samples for _, _, one in rows]),
        ),
        note="independent samples: what the errors of the phase are worth, by their memory",
    )
    return RecordContent(
        method="attitude_error",
        model=Model(
            name="strapdown_attitude_error" if computed_here else "attitude_error",
            equation="sigma = rms(attitude - reference), about zero",
        ),
        quantities=tuple(quantities),
        tables=(by_phase, *tables),
    )


def _numbered(phase: str, numbers: Mapping[str, int]) -> str:
    words = phase.replace("_", " ")
    return f"{words} ({numbers[phase]})" if phase in numbers else words


def _both(
    roll: Mapping[str, ErrorFigure], pitch: Mapping[str, ErrorFigure]
) -> tuple[tuple[str, Mapping[str, ErrorFigure]], ...]:
    return (("roll", roll), ("pitch", pitch))


def curves_table(name: str, columns: Mapping[str, tuple[str, FloatArray]]) -> RecordTable:
    """Curves for a plot: name → (unit, values), the abscissa first; thinned evenly to `MOST_ROWS`."""
    rows = max(len(values) for _, values in columns.values())
    chosen = np.unique(np.linspace(0, rows - 1, min(rows, MOST_ROWS)).round().astype(int))
    return RecordTable(
        name=name,
        columns=tuple(_column(word, unit, values[chosen]) for word, (unit, values) in columns.items()),
    )


def _column(name: str, unit: str, values: Sequence[float] | FloatArray | np.ndarray) -> TableColumn:
    return TableColumn(name=name, unit=unit, values=tuple(float(value) for value in values))
