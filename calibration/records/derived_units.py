# pyright: strict
"""Units of coefficients: those of the one table, and quotients of them.

    unit = KNOWN | unit '/(' KNOWN ')' | unit '/sqrt(' KNOWN ')'

V/(deg/s) is a scale factor, 1/(m/s^2) a quadratic one, m/s^2/(degC) a sensitivity to temperature and
rad/s/sqrt(s) a rate random walk. Nothing is guessed, as in `protocol.units_of_measure`.
"""

import math
import re
from dataclasses import dataclass

from protocol.errors import Fault, TestloomError
from protocol.units_of_measure import factor_to_si, is_known_unit, quantity_of

MAX_DENOMINATORS = 4
_LAST_DENOMINATOR = re.compile(r"(?P<head>.+)/(?P<root>sqrt)?\((?P<unit>[^()]+(?:\([^()]+\))?)\)")

_PER_S = re.compile(r"/s(?:\^(?P<power>\d))?/\(s\)$")


@dataclass(frozen=True)
class DerivedUnit:
    """A unit taken apart. `dimension`: kinds of quantity, the numerator first; `factor`: to SI."""

    dimension: tuple[str, ...]
    factor: float


def derived_unit(text: str) -> DerivedUnit:
    """The unit that a text spells.

    Raises:
        TestloomError: it is none, or divides by more than `MAX_DENOMINATORS`.
    """
    denominators: list[str] = []
    factor, head = 1.0, text
    while not is_known_unit(head):
        found = _LAST_DENOMINATOR.fullmatch(head)
        if found is None or not is_known_unit(found["unit"]) or len(denominators) == MAX_DENOMINATORS:
            raise TestloomError(
                f"The unit '{text}' is not known.",
                fault=Fault.DATA,
                remedy="use a unit of protocol/units_of_measure.py, or a quotient such as V/(deg/s).",
            )
        below, kind = factor_to_si(found["unit"]), quantity_of(found["unit"])
        factor /= math.sqrt(below) if found["root"] else below
        denominators.append(f"sqrt({kind})" if found["root"] else kind)
        head = found["head"]
    return DerivedUnit((quantity_of(head), *sorted(denominators)), factor_to_si(head) * factor)


def derived_conversion_factor(unit_from: str, unit_to: str) -> float:
    """Multiply a value in `unit_from` by this to have it in `unit_to`.

    Raises:
        TestloomError: a unit is not known, or the two do not measure the same.
    """
    given, wanted = derived_unit(unit_from), derived_unit(unit_to)
    if given.dimension != wanted.dimension:
        raise TestloomError(
            f"'{unit_from}' and '{unit_to}' do not measure the same: one cannot be converted into the other.",
            fault=Fault.DATA,
            remedy="see which unit of measure is meant.",
        )
    return given.factor / wanted.factor


def written_unit(text: str) -> str:
    """A unit as people write it: 'rad/s/(s)' is rad/s^2, 'm/s^2/(s)' m/s^3.

    For pages only: records keep the spelling that `derived_unit` reads.
    """
    return _PER_S.sub(lambda found: f"/s^{int(found['power'] or 1) + 1}", text)
