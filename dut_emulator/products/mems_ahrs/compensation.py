# pyright: strict
"""The unit's own correction of its sensors, and the flash that keeps it (paper 2, Eqs. 2 and 3).

    u = K (N − σ(N, T) − b)        σ_i = a_i(T) N_i² + b_i(T) N_i + c_i(T)

K and b of room temperature; a, b, c at nodes of temperature, straight between them, held beyond the ends. A
new unit has K = I and no node: it gives what its sensors give.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import FloatArray
from protocol.errors import Fault, TestloomError
from protocol.mems_ahrs import MAX_NODES, Sensor

FORMAT = "testloom-flash/1"
MIN_DETERMINANT = 1e-3
"""The firmware refuses a matrix nearer to singular than this."""

Numbers = tuple[float, ...]
_IDENTITY: Numbers = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Node:
    """One temperature: a (1/SI), b, c (SI) of x, then of y, then of z."""

    temperature_c: float
    coefficients: Numbers

    @property
    def is_acceptable(self) -> bool:
        """All numbers are finite."""
        return bool(np.isfinite([self.temperature_c, *self.coefficients]).all())


@dataclass(frozen=True)
class TriadCompensation:
    """What is written for one triad: `matrix` K row by row (9), `bias` b (3), nodes by rising temperature."""

    matrix: Numbers = _IDENTITY
    bias: Numbers = (0.0, 0.0, 0.0)
    nodes: tuple[Node, ...] = ()

    @property
    def is_blank(self) -> bool:
        """As in a new unit: nothing is corrected."""
        return self == TriadCompensation()

    @property
    def is_acceptable(self) -> bool:
        """Finite, and the matrix can be inverted; nodes ascend."""
        finite = bool(np.isfinite([*self.matrix, *self.bias]).all())
        ascending = bool(np.all(np.diff([node.temperature_c for node in self.nodes]) > 0))
        return (
            finite
            and ascending
            and len(self.nodes) <= MAX_NODES
            and all(node.is_acceptable for node in self.nodes)
            and abs(float(np.linalg.det(np.reshape(self.matrix, (3, 3))))) > MIN_DETERMINANT
        )

    def with_node(self, index: int, node: Node) -> "TriadCompensation":
        """A node replaced, or added at the end when `index` is the next one.

        Raises:
            IndexError: `index` is beyond that.
        """
        if index > len(self.nodes):
            raise IndexError(index)
        return replace(self, nodes=(*self.nodes[:index], node, *self.nodes[index + 1 :]))

    def apply(self, output_si: FloatArray, temperature_c: FloatArray) -> FloatArray:
        """Outputs (n, 3) in SI at sensor temperatures (n,) → inputs (n, 3)."""
        if self.is_blank:
            return output_si
        rest = output_si - np.asarray(self.bias)
        if self.nodes:
            rest -= self._sigma(output_si, temperature_c)
        columns = [np.ascontiguousarray(rest[:, axis]) for axis in range(3)]
        inputs = np.empty_like(output_si)
        for axis, row in enumerate(np.reshape(self.matrix, (3, 3))):  # term by term: chunks round alike
            inputs[:, axis] = columns[0] * row[0] + columns[1] * row[1] + columns[2] * row[2]
        return inputs

    def _sigma(self, output_si: FloatArray, temperature_c: FloatArray) -> FloatArray:
        at_c = np.array([node.temperature_c for node in self.nodes])
        table = np.array([node.coefficients for node in self.nodes])
        sigma = np.empty_like(output_si)
        for axis in range(3):
            a, b, c = (np.interp(temperature_c, at_c, table[:, 3 * axis + power]) for power in range(3))
            sigma[:, axis] = (a * output_si[:, axis] + b) * output_si[:, axis] + c
        return sigma


@dataclass(frozen=True)
class Flash:
    """The unit's non-volatile memory."""

    power_cycles: int = 0
    triads: Mapping[Sensor, TriadCompensation] = field(
        default_factory=lambda: {sensor: TriadCompensation() for sensor in Sensor}
    )

    @property
    def is_blank(self) -> bool:
        """No triad is corrected."""
        return all(triad.is_blank for triad in self.triads.values())

    def after_power_on(self) -> "Flash":
        """One power-on more."""
        return replace(self, power_cycles=self.power_cycles + 1)

    def with_triad(self, sensor: Sensor, triad: TriadCompensation) -> "Flash":
        """Another correction for one triad."""
        return replace(self, triads={**self.triads, sensor: triad})

    def as_image(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "format": FORMAT,
            "product": "mems_ahrs",
            "power_cycles": self.power_cycles,
            "triads": {
                sensor.name: {
                    "matrix": list(triad.matrix),
                    "bias": list(triad.bias),
                    "nodes": [[node.temperature_c, *node.coefficients] for node in triad.nodes],
                }
                for sensor, triad in self.triads.items()
            },
        }

    @staticmethod
    def from_image(image: Mapping[str, Any]) -> "Flash":
        """From what `as_image` gave.

        Raises:
            TestloomError: it is another format, or another product's.
        """
        if (image.get("format"), image.get("product")) != (FORMAT, "mems_ahrs"):
            raise TestloomError(
                f"The flash image is a {image.get('product')!r} of the format {image.get('format')!r}.",
                where="emulated unit's flash",
                fault=Fault.DATA,
                remedy=f"give an image of a mems_ahrs of the format {FORMAT}, or none for a new unit.",
            )
        entries = cast("dict[str, dict[str, list[Any]]]", image["triads"])
        triads = {
            Sensor[name]: TriadCompensation(
                tuple(entry["matrix"]),
                tuple(entry["bias"]),
                tuple(Node(float(row[0]), tuple(row[1:])) for row in entry["nodes"]),
            )
            for name, entry in entries.items()
        }
        return Flash(int(image["power_cycles"]), triads)
