# pyright: strict
"""How a quantity moves over a unit's life: a weighted straight line, its drift, and points beside it.

    y_k = c + d (t_k - t_mean) + e_k,  weights 1 / u_k^2;  u(d)^2 = 1 / sum w_k (t_k - t_mean)^2

Where the points scatter by more than their uncertainties (chi-square per degree of freedom above 1), the
uncertainties of the line grow by its root (Birge): turn-on repeatability is then in them.

A point is an outlier if it lies off the line of the *others* by more than chance allows among all points
(Bonferroni, 5 %). The worst goes first and the rest are looked at again; three points always stay.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.uncertainty_budget import t_quantile
from calibration.records.comparing import SIGNIFICANT, two_sided
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord

SECONDS_PER_YEAR = 365.25 * 86_400.0
MIN_POINTS_OF_LINE = 2
MIN_POINTS_FOR_OUTLIERS = 4
_CLEAR_BIRGE = 1.0


@dataclass(frozen=True)
class HistoryPoint:
    """One record's value in the history's unit."""

    time: datetime
    value: float
    standard_uncertainty: float
    record_sha256: str
    method: str
    outlier: bool = False


@dataclass(frozen=True)
class Trend:
    """The line.

    Attributes:
        mean_years: weighted mean time, years after the first point.
        value, value_standard_uncertainty: there.
        drift_per_year, drift_standard_uncertainty: None where all points are of one time.
        birge_ratio: root of chi-square per degree of freedom; None without degrees of freedom.
        degrees_of_freedom: points used less parameters.
    """

    mean_years: float
    value: float
    value_standard_uncertainty: float
    drift_per_year: float | None
    drift_standard_uncertainty: float | None
    birge_ratio: float | None
    degrees_of_freedom: int

    def at(self, years: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Line and its standard uncertainty at times (n,), years after the first point."""
        off = np.asarray(years, dtype=np.float64) - self.mean_years
        drift, uncertainty = self.drift_per_year or 0.0, self.drift_standard_uncertainty or 0.0
        return self.value + drift * off, np.hypot(self.value_standard_uncertainty, uncertainty * off)

    @property
    def drifts(self) -> bool:
        """Whether the drift differs from 0 (5 %, this quantity alone)."""
        if self.drift_per_year is None or not self.drift_standard_uncertainty:
            return False
        widened = self.birge_ratio is not None and self.birge_ratio > _CLEAR_BIRGE
        freedom = self.degrees_of_freedom if widened else math.inf
        return two_sided(self.drift_per_year / self.drift_standard_uncertainty, freedom) < SIGNIFICANT


@dataclass(frozen=True)
class QuantityHistory:
    """One quantity of one sensor of one unit, oldest point first."""

    product: str
    serial: str
    sensor: str
    name: str
    symbol: str
    unit: str
    points: tuple[HistoryPoint, ...]
    trend: Trend

    def years(self) -> FloatArray:
        """Times of the points after the first one, shape (n,)."""
        return _years([point.time for point in self.points])


def history_of(records: Iterable[CalibrationRecord]) -> tuple[QuantityHistory, ...]:
    """Histories of all quantities whose standard uncertainties are known and not zero.

    A record that is there twice counts once. Values are in the unit of the oldest record.

    Raises:
        TestloomError: a quantity changes its kind of unit between records.
    """
    ordered = sorted(
        {record.sha256(): record for record in records}.items(), key=lambda kv: (kv[1].time, kv[0])
    )
    found: dict[tuple[str, str, str, str], list[HistoryPoint]] = {}
    first_seen: dict[tuple[str, str, str, str], tuple[str, str]] = {}
    for sha256, record in ordered:
        for quantity in record.quantities:
            if not quantity.standard_uncertainty:
                continue
            key = (record.product, record.serial, record.sensor, quantity.name)
            unit, _ = first_seen.setdefault(key, (quantity.unit, quantity.symbol))
            factor = derived_conversion_factor(quantity.unit, unit)
            found.setdefault(key, []).append(
                HistoryPoint(
                    record.time,
                    factor * quantity.value,
                    factor * quantity.standard_uncertainty,
                    sha256,
                    record.method,
                )
            )
    return tuple(
        _history(key, first_seen[key], points)
        for key, points in sorted(found.items(), key=lambda item: item[0][:3])
    )


def fit_trend(years: FloatArray, values: FloatArray, uncertainties: FloatArray) -> Trend:
    """The weighted line through points, shapes (n,), n >= 1, uncertainties above 0."""
    weights = uncertainties**-2.0
    total = float(weights.sum())
    mean_years = float(weights @ years) / total
    mean = float(weights @ values) / total
    off = years - mean_years
    spread = float(weights @ off**2)
    sloped = len(values) >= MIN_POINTS_OF_LINE and float(np.ptp(years)) > 0.0
    drift = float(weights @ (off * (values - mean))) / spread if sloped else 0.0
    freedom = len(values) - (2 if sloped else 1)
    chi_square = float(weights @ (values - mean - drift * off) ** 2)
    birge = math.sqrt(chi_square / freedom) if freedom > 0 else None
    widening = max(1.0, birge or 0.0)
    return Trend(
        mean_years,
        mean,
        widening / math.sqrt(total),
        drift if sloped else None,
        widening / math.sqrt(spread) if sloped else None,
        birge,
        freedom,
    )


def outliers(years: FloatArray, values: FloatArray, uncertainties: FloatArray) -> frozenset[int]:
    """Indices of the points that do not belong to the line of the others."""
    kept = list(range(len(values)))
    while len(kept) >= MIN_POINTS_FOR_OUTLIERS:
        excess: dict[int, float] = {}
        for index in kept:
            others = np.array([k for k in kept if k != index])
            trend = fit_trend(years[others], values[others], uncertainties[others])
            line, of_line = trend.at(years[[index]])
            widening = max(1.0, trend.birge_ratio or 0.0)
            freedom = trend.degrees_of_freedom if widening > _CLEAR_BIRGE else math.inf
            off = abs(float(values[index] - line[0]))
            # The point's own uncertainty is widened as the others' are: it comes from the same process.
            ratio = off / math.hypot(widening * float(uncertainties[index]), float(of_line[0]))
            excess[index] = ratio / t_quantile(1.0 - SIGNIFICANT / (2.0 * len(kept)), freedom)
        worst = max(excess, key=lambda index: excess[index])
        if excess[worst] <= 1.0:
            break
        kept.remove(worst)
    return frozenset(range(len(values))) - frozenset(kept)


def _history(
    key: tuple[str, str, str, str], seen: tuple[str, str], points: Sequence[HistoryPoint]
) -> QuantityHistory:
    years = _years([point.time for point in points])
    values = np.array([point.value for point in points])
    uncertainties = np.array([point.standard_uncertainty for point in points])
    beside = outliers(years, values, uncertainties)
    used = [k for k in range(len(points)) if k not in beside]
    product, serial, sensor, name = key
    marked = tuple(
        HistoryPoint(p.time, p.value, p.standard_uncertainty, p.record_sha256, p.method, k in beside)
        for k, p in enumerate(points)
    )
    trend = fit_trend(years[used], values[used], uncertainties[used])
    return QuantityHistory(product, serial, sensor, name, seen[1], seen[0], marked, trend)


def _years(times: Sequence[datetime]) -> FloatArray:
    return np.array([(time - times[0]).total_seconds() / SECONDS_PER_YEAR for time in times])
