"""A table of uncertainty: what contributes how much to one result, and what follows from the sum.

    u_c^2 = sum (c_i u_i)^2          for quantities that do not depend on each other (GUM, 5.1.2)
    nu_eff = u_c^4 / sum ((c_i u_i)^4 / nu_i)          Welch-Satterthwaite (GUM, G.4.1)

Quantities that do depend on each other belong into one row, propagated together beforehand.
"""

# pyright: strict
import math
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtrit  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from protocol.errors import CalibrationError, Fault

Distribution = Literal["normal", "t", "uniform"]

COVERAGE_95 = 0.9545
"""What k = 2 covers of a normal distribution."""
LIMIT_FRACTION = 1.0 / 3.0
"""An expanded uncertainty may be this part of the limit that it is used to judge (paper 4)."""


@dataclass(frozen=True)
class BudgetRow:
    """One quantity's part in the uncertainty of a result.

    Attributes:
        quantity: its name and where its value comes from.
        estimate: its value, in `unit`.
        unit: of the estimate and of the standard uncertainty.
        standard_uncertainty: u_i.
        distribution: that its knowledge is modelled by.
        sensitivity: c_i, unit of the result per `unit`.
        degrees_of_freedom: nu_i; infinite for a bound that is known.
    """

    quantity: str
    estimate: float
    unit: str
    standard_uncertainty: float
    distribution: Distribution
    sensitivity: float
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        numbers = (self.estimate, self.standard_uncertainty, self.sensitivity)
        if not all(math.isfinite(number) for number in numbers):
            raise _refused(f"'{self.quantity}' has a value, uncertainty or sensitivity that is not finite.")
        if self.standard_uncertainty < 0 or not self.degrees_of_freedom > 0:
            raise _refused(f"'{self.quantity}' has a negative uncertainty or no degree of freedom.")

    @property
    def contribution(self) -> float:
        """c_i u_i with its sign, in the unit of the result."""
        return self.sensitivity * self.standard_uncertainty


@dataclass(frozen=True)
class UncertaintyBudget:
    """The rows of one result's uncertainty.

    Attributes:
        result: its name.
        estimate: its value, in `unit`.
        unit: of the result.
        rows: at least one.
        note: which form of the budget this is, for a person who sees two beside each other.
    """

    result: str
    estimate: float
    unit: str
    rows: tuple[BudgetRow, ...]
    note: str = ""

    def __post_init__(self) -> None:
        if not self.rows:
            raise _refused(f"The budget of '{self.result}' has no row.")

    @property
    def standard_uncertainty(self) -> float:
        """u_c, in the unit of the result."""
        return math.sqrt(math.fsum(row.contribution**2 for row in self.rows))

    @property
    def degrees_of_freedom(self) -> float:
        """nu_eff; infinite if every row's is, or if nothing is uncertain."""
        parts = math.fsum(row.contribution**4 / row.degrees_of_freedom for row in self.rows)
        return self.standard_uncertainty**4 / parts if parts > 0 else math.inf

    def coverage_factor(self, probability: float = COVERAGE_95) -> float:
        """k of the t distribution with nu_eff degrees of freedom (GUM, G.4)."""
        if not 0 < probability < 1:
            raise _refused(f"A coverage probability of {probability:g} is not between 0 and 1.")
        return t_quantile(0.5 * (1.0 + probability), self.degrees_of_freedom)

    def expanded_uncertainty(self, coverage_factor: float = 2.0) -> float:
        """U = k u_c, in the unit of the result."""
        return coverage_factor * self.standard_uncertainty

    def against_limit(self, limit: float, coverage_factor: float = 2.0) -> "LimitCheck":
        """Is the measurement good enough to judge a result against `limit` (in the unit of the result)?"""
        if not (math.isfinite(limit) and limit > 0):
            raise _refused(f"'{self.result}' has a limit of {limit:g}: not a positive number.")
        return LimitCheck(self.expanded_uncertainty(coverage_factor), limit)


@dataclass(frozen=True)
class LimitCheck:
    """U against a third of the limit, both in the unit of the result."""

    expanded_uncertainty: float
    limit: float

    @property
    def ratio(self) -> float:
        """U / limit."""
        return self.expanded_uncertainty / self.limit

    @property
    def good_enough(self) -> bool:
        """U <= limit / 3."""
        return self.ratio <= LIMIT_FRACTION


def t_quantile(probability: float, degrees_of_freedom: float) -> float:
    """Quantile of Student's t; of the normal distribution for infinite degrees of freedom."""
    return float(stdtrit(min(degrees_of_freedom, 1e9), probability))  # pyright: ignore[reportUnknownArgumentType]


def t_inflation(degrees_of_freedom: float) -> float:
    """Standard deviation of the t distribution (JCGM 101:2008, 6.4.9.2), at least 3 degrees of freedom.

    Raises:
        CalibrationError: with 2 or fewer, where that standard deviation does not exist.
    """
    if math.isinf(degrees_of_freedom):
        return 1.0
    if degrees_of_freedom <= 2:
        raise _refused(f"{degrees_of_freedom:g} degrees of freedom carry no standard uncertainty; 3 do.")
    return math.sqrt(degrees_of_freedom / (degrees_of_freedom - 2.0))


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what,
        where="uncertainty budget",
        fault=Fault.DATA,
        remedy="take more readings, or state the uncertainty of every quantity that enters.",
    )
