# pyright: strict
"""A profile: what a stand is told to do, by name, with parameters in stated units and ranges."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from protocol.errors import Fault, TestloomError


@dataclass(frozen=True)
class ProfileParameter:
    """A number that shapes a profile. `low` and `high` belong to the range."""

    name: str
    default: float
    unit: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True)
class ProfileKind:
    """A profile as the catalogue lists it. `reveals`: what it is for, in words for a test engineer."""

    name: str
    reveals: str
    parameters: tuple[ProfileParameter, ...] = ()

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """All parameters: those given, the others at their defaults.

        Raises:
            TestloomError: an unknown parameter, or one outside its range.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, value in given.items():
            if name not in known:
                raise self._refused(
                    f"The profile '{self.name}' has no parameter '{name}'.",
                    f"use some of: {', '.join(known) or 'none'}.",
                )
            parameter = known[name]
            if not (math.isfinite(value) and parameter.low <= value <= parameter.high):
                unit = "" if parameter.unit == "1" else f" {parameter.unit}"
                raise self._refused(
                    f"{name} cannot be {value:g}{unit}.",
                    f"give {parameter.low:g} to {parameter.high:g}{unit}.",
                )
        return {name: given.get(name, parameter.default) for name, parameter in known.items()}

    def _refused(self, what: str, remedy: str) -> TestloomError:
        return TestloomError(what, where=f"profile {self.name}", fault=Fault.OPERATOR, remedy=remedy)
