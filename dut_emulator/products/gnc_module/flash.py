# pyright: strict
"""What the unit keeps without power: compensation coefficients and the count of its power-ons."""

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, TestloomError
from protocol.gnc_module import Sensor

FORMAT = "testloom-flash/1"
MIN_DETERMINANT = 1e-3
"""The firmware refuses a matrix nearer to singular than this."""

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Coefficients:
    """u = K (y − b): `matrix` K row by row (9), `bias` (3) in SI of the sensor."""

    matrix: Numbers = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    bias: Numbers = (0.0, 0.0, 0.0)

    @property
    def is_acceptable(self) -> bool:
        """Finite, and the matrix can be inverted."""
        finite = bool(np.all(np.isfinite(self.matrix)) and np.all(np.isfinite(self.bias)))
        return finite and abs(float(np.linalg.det(np.reshape(self.matrix, (3, 3))))) > MIN_DETERMINANT

    def compensate(self, output_si: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outputs (n, 3) in SI → inputs (n, 3)."""
        return (output_si - np.asarray(self.bias)) @ np.reshape(self.matrix, (3, 3)).T


@dataclass(frozen=True)
class Flash:
    """The unit's non-volatile memory."""

    power_cycles: int = 0
    coefficients: dict[Sensor, Coefficients] = field(
        default_factory=lambda: {sensor: Coefficients() for sensor in Sensor}
    )

    def after_power_on(self) -> "Flash":
        """One power-on more."""
        return replace(self, power_cycles=self.power_cycles + 1)

    def with_coefficients(self, sensor: Sensor, coefficients: Coefficients) -> "Flash":
        """New coefficients for one triad."""
        return replace(self, coefficients={**self.coefficients, sensor: coefficients})

    def as_image(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "format": FORMAT,
            "power_cycles": self.power_cycles,
            "coefficients": {
                sensor.name: {"matrix": list(entry.matrix), "bias": list(entry.bias)}
                for sensor, entry in self.coefficients.items()
            },
        }

    @staticmethod
    def from_image(image: dict[str, Any]) -> "Flash":
        """From what `as_image` gave.

        Raises:
            TestloomError: it is another format.
        """
        if image.get("format") != FORMAT:
            raise TestloomError(
                f"The flash image has the format {image.get('format')!r}.",
                where="emulated unit's flash",
                fault=Fault.DATA,
                remedy=f"give an image of the format {FORMAT}, or none for a new unit.",
            )
        entries = cast("dict[str, dict[str, list[float]]]", image["coefficients"])
        coefficients = {
            Sensor[name]: Coefficients(tuple(entry["matrix"]), tuple(entry["bias"]))
            for name, entry in entries.items()
        }
        return Flash(int(image["power_cycles"]), coefficients)
