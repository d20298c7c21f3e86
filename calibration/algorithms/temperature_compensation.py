"""Temperature compensation on the sensor's own output, the matrix frozen at room temperature (paper 2).

    N - sigma(N, T) = M E + D                              eq (2): M, D of room temperature
    sigma_i(N_i, T) = a_i(T) N_i^2 + b_i(T) N_i + c_i(T)   eq (3); piecewise linear: a = 0

a, b, c stand at nodes every 5 deg C from room temperature, where they are zero, and run straight
between nodes: 0.02 mg of error in the oracle's unit, against 2.2 mg with the nearest node's.

sigma is what the output has more than at room temperature in the *same pose and mounting*; it is fitted
on N, the output that the firmware has at hand, and not on the true input. A thermal chamber with one
axis is enough, and mounting a unit there anew costs nothing. What the frozen matrix cannot follow is a
cross-coupling that changes with temperature; it stays in the residuals.

All nodes of an axis are one linear least-squares problem in hat functions of T, so that soaks and
slow ramps with temperatures between the nodes do equally.
"""

# pyright: strict
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.uncertainty_budget import t_inflation
from protocol.errors import CalibrationError, Fault

Order = Literal["linear", "quadratic"]

NODE_STEP_C = 5.0
NODE_MARGIN_C = 1.0
"""A soak this close to a node counts as reaching it; readings further outside are left out."""
MAX_NODES = 101
MAX_READINGS = 200_000
MIN_STRENGTH = 1e-3
"""Smallest singular value of an axis's scaled design, relative to the largest, that carries coefficients."""
POWER_WORDS = ("square", "slope", "constant")


@dataclass(frozen=True)
class ThermalReadings:
    """Means at rest (or at a steady rate) over poses and temperatures.

    Attributes:
        output: N, shape (m, 3), SI.
        room_output: N of the same pose and mounting at room temperature, shape (m, 3), SI.
        temperature_c: of the sensor, shape (m,).
        ramp: +1 while warming, -1 while cooling, 0 unknown, shape (m,).
    """

    output: FloatArray
    room_output: FloatArray
    temperature_c: FloatArray
    ramp: NDArray[np.int_]

    def __post_init__(self) -> None:
        count = len(self.temperature_c)
        if not 0 < count <= MAX_READINGS:
            raise refused(f"{count} readings: there must be 1 to {MAX_READINGS}.")
        for name, shape in (
            ("output", (count, 3)),
            ("room_output", (count, 3)),
            ("temperature_c", (count,)),
            ("ramp", (count,)),
        ):
            values = np.asarray(getattr(self, name))
            if values.shape != shape:
                raise refused(f"The {name} has shape {values.shape}, not {shape}.")
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values))[0][0])
                raise refused(f"The {name} of reading {row} is missing.")

    def only(self, rows: NDArray[np.bool_]) -> "ThermalReadings":
        """Some of the readings."""
        return ThermalReadings(
            self.output[rows], self.room_output[rows], self.temperature_c[rows], self.ramp[rows]
        )


@dataclass(frozen=True)
class Compensated:
    """Compensated readings.

    Attributes:
        input_si: E, shape (m, 3).
        standard_uncertainty_si: of E from the coefficients, shape (m, 3); NaN beyond the calibrated range.
        beyond_calibrated_range: shape (m,): there the end node's coefficients are held, not continued, and
            how wrong they are is not known.
    """

    input_si: FloatArray
    standard_uncertainty_si: FloatArray
    beyond_calibrated_range: NDArray[np.bool_]


@dataclass(frozen=True)
class TemperatureModel:
    """sigma(N, T) of three axes over the frozen coefficients of room temperature.

    Attributes:
        room: M, D; the frozen matrix.
        node_c: temperatures of the nodes, shape (k,), ascending.
        coefficients: shape (k, 3, 3): node, axis, (a in 1/SI, b, c in SI).
        covariance: of each axis's coefficients, node by node, shape (3, 3k, 3k). Readings count as
            independent; what one pose's room output errs is shared by all nodes.
        residual_rms_si: of each axis, shape (3,): noise, and what the model cannot follow.
        degrees_of_freedom: of each axis.
        left_out: readings outside the nodes, which no coefficient rests on.
    """

    room: TriadCoefficients
    node_c: FloatArray
    coefficients: FloatArray
    covariance: FloatArray
    residual_rms_si: FloatArray
    degrees_of_freedom: int
    left_out: int

    @property
    def calibrated_range_c(self) -> tuple[float, float]:
        """First and last node."""
        return float(self.node_c[0]), float(self.node_c[-1])

    def sigma(
        self,
        output: FloatArray,
        temperature_c: FloatArray,
        lookup: Literal["interpolated", "nearest_node"] = "interpolated",
    ) -> FloatArray:
        """sigma(N, T), shape (m, 3), SI, of outputs (m, 3) at temperatures (m,).

        Beyond the calibrated range the end node's coefficients hold. 'nearest_node' is the paper's
        segment of 5 deg C, for comparison.
        """
        weights = hat_weights(self.node_c, temperature_c)
        if lookup == "nearest_node":
            nearest = np.abs(temperature_c[:, None] - self.node_c).argmin(axis=1)
            weights = np.eye(len(self.node_c))[nearest]
        at_temperature = np.tensordot(weights, self.coefficients, axes=1)
        return np.einsum("map,map->ma", at_temperature, _powers(output))

    def sigma_standard_uncertainty(self, output: FloatArray, temperature_c: FloatArray) -> FloatArray:
        """u(sigma), shape (m, 3), SI, from the coefficients' covariance."""
        basis = np.einsum("mk,map->makp", hat_weights(self.node_c, temperature_c), _powers(output))
        flat = basis.reshape(len(output), 3, -1)
        variance = np.einsum("mai,aij,maj->ma", flat, self.covariance, flat)
        return np.sqrt(np.maximum(variance, 0.0))

    def compensate(self, output: FloatArray, temperature_c: FloatArray) -> Compensated:
        """E = inv(M) (N - sigma - D), eq (2), with what is uncertain and what is beyond the range.

        Args:
            output: shape (m, 3), SI.
            temperature_c: shape (m,).
        """
        corrected = output - self.sigma(output, temperature_c)
        inverse = self.room.compensation
        from_sigma = self.sigma_standard_uncertainty(output, temperature_c) ** 2 @ (inverse**2).T
        centred = corrected - self.room.bias
        # dE_i = sum_j dK_ij r_j - sum_j K_ij dD_j
        gradient = np.zeros((len(output), 3, 12))
        for axis in range(3):
            gradient[:, axis, 3 * axis : 3 * axis + 3] = centred
            gradient[:, axis, 9:] = -inverse[axis]
        from_room = np.einsum("mai,ij,maj->ma", gradient, self.room.compensation_covariance(), gradient)
        low, high = self.calibrated_range_c
        beyond = (temperature_c < low - NODE_MARGIN_C) | (temperature_c > high + NODE_MARGIN_C)
        uncertainty = np.sqrt(np.maximum(from_sigma + from_room, 0.0))
        uncertainty[beyond] = np.nan
        return Compensated(self.room.compensate(corrected), uncertainty, np.asarray(beyond))


def hat_weights(node_c: FloatArray, temperature_c: FloatArray) -> FloatArray:
    """Weights (m, k) of the nodes at temperatures (m,): straight between nodes, held beyond the ends."""
    place = np.clip(np.searchsorted(node_c, temperature_c) - 1, 0, max(len(node_c) - 2, 0))
    weights = np.zeros((len(temperature_c), len(node_c)))
    rows = np.arange(len(temperature_c))
    if len(node_c) == 1:
        weights[:, 0] = 1.0
        return weights
    along = np.clip((temperature_c - node_c[place]) / (node_c[place + 1] - node_c[place]), 0.0, 1.0)
    weights[rows, place], weights[rows, place + 1] = 1.0 - along, along
    return weights


def fit_temperature(
    readings: ThermalReadings,
    room: TriadCoefficients,
    room_temperature_c: float,
    order: Order = "quadratic",
    step_c: float = NODE_STEP_C,
) -> TemperatureModel:
    """Fit a, b, c at every node but that of room temperature, where they are zero.

    Args:
        readings: over the whole range, in at least three inputs per axis (-1 g, 0, +1 g) at each node for
            'quadratic', two for 'linear'.
        room: what is frozen.
        room_temperature_c: that `room` was found at; nodes stand at whole steps from it.

    Raises:
        CalibrationError: room temperature outside the readings, or an axis that a node lacks inputs of.
    """
    return _fit(readings, room, room_temperature_c, order, step_c, anchored=True)


@dataclass(frozen=True)
class RampHysteresis:
    """The largest difference of sigma between warming and cooling, of one axis.

    Attributes:
        axis: 'x', 'y' or 'z'.
        difference_si: warming less cooling, with its sign.
        standard_uncertainty_si: of it.
        temperature_c, output_si: where.
    """

    axis: str
    difference_si: float
    standard_uncertainty_si: float
    temperature_c: float
    output_si: float


def ramp_hysteresis(
    readings: ThermalReadings,
    room: TriadCoefficients,
    room_temperature_c: float,
    order: Order = "quadratic",
    step_c: float = NODE_STEP_C,
) -> tuple[RampHysteresis, RampHysteresis, RampHysteresis]:
    """Fit both ramps apart, room temperature included, and compare them at common nodes.

    The largest of many differences: without any hysteresis it is still two to three of its uncertainties.

    Raises:
        CalibrationError: a ramp is missing or cannot be fitted, or the ramps share no node.
    """
    for sign, name in ((1, "warming"), (-1, "cooling")):
        if not (readings.ramp == sign).any():
            raise refused(f"No reading was taken while {name}: the hysteresis is not told.")
    up, down = (
        _fit(readings.only(readings.ramp == sign), room, room_temperature_c, order, step_c, anchored=False)
        for sign in (1, -1)
    )
    common = np.intersect1d(up.node_c, down.node_c)
    if len(common) == 0:
        raise refused("The two ramps share no temperature: the hysteresis is not told.")
    low, high = readings.output.min(axis=0), readings.output.max(axis=0)
    levels = np.array([low, 0.5 * (low + high), high])
    temperature = np.repeat(common, len(levels))
    output = np.tile(levels, (len(common), 1))
    difference = up.sigma(output, temperature) - down.sigma(output, temperature)
    uncertainty = np.hypot(
        up.sigma_standard_uncertainty(output, temperature),
        down.sigma_standard_uncertainty(output, temperature),
    )

    def widest(axis: int) -> RampHysteresis:
        row = int(np.abs(difference[:, axis]).argmax())
        return RampHysteresis(
            "xyz"[axis],
            float(difference[row, axis]),
            float(uncertainty[row, axis]),
            float(temperature[row]),
            float(output[row, axis]),
        )

    return widest(0), widest(1), widest(2)


def _fit(
    readings: ThermalReadings,
    room: TriadCoefficients,
    room_temperature_c: float,
    order: Order,
    step_c: float,
    *,
    anchored: bool,
) -> TemperatureModel:
    nodes = whole_nodes(readings.temperature_c, room_temperature_c, step_c)
    inside = (readings.temperature_c >= nodes[0] - NODE_MARGIN_C) & (
        readings.temperature_c <= nodes[-1] + NODE_MARGIN_C
    )
    used = readings.only(inside)
    free = np.ones(len(nodes), dtype=np.bool_)
    if anchored:
        at_room = np.abs(nodes - room_temperature_c) < 0.5 * step_c
        if not at_room.any():
            raise refused("Room temperature is not within the temperatures of the readings.")
        free = ~at_room
    powers = np.array([2, 1, 0] if order == "quadratic" else [1, 0])
    columns = int(free.sum()) * len(powers)
    dof = len(used.output) - columns
    if columns == 0 or dof < 3:
        raise refused(
            f"{len(used.output)} readings do not carry {columns} coefficients and their uncertainty."
        )
    weights = hat_weights(nodes, used.temperature_c)[:, free]
    coefficients = np.zeros((len(nodes), 3, 3))
    covariance = np.zeros((3, len(nodes), 3, len(nodes), 3))
    residual_rms = np.empty(3)
    node, term = (
        grid.ravel() for grid in np.meshgrid(np.flatnonzero(free), 2 - powers.astype(np.intp), indexing="ij")
    )
    for axis in range(3):
        design, unscale = _design(weights, used.output[:, axis], powers)
        left, strength, right = _decomposed(design, nodes[free], powers, "xyz"[axis])
        sigma = used.output[:, axis] - used.room_output[:, axis]
        solution = right.T @ ((left.T @ sigma) / strength)
        residual = sigma - design @ solution
        residual_rms[axis] = math.sqrt(float(residual @ residual) / dof)
        coefficients[node, axis, term] = solution * unscale
        spread = unscale[:, None] * (right.T / strength) * (residual_rms[axis] * t_inflation(dof))
        covariance[axis][node[:, None], term[:, None], node[None, :], term[None, :]] = spread @ spread.T
    return TemperatureModel(
        room=room,
        node_c=nodes,
        coefficients=coefficients,
        covariance=covariance.reshape(3, 3 * len(nodes), 3 * len(nodes)),
        residual_rms_si=residual_rms,
        degrees_of_freedom=dof,
        left_out=int((~inside).sum()),
    )


def whole_nodes(temperature_c: FloatArray, room_temperature_c: float, step_c: float) -> FloatArray:
    """Whole steps from room temperature that the readings reach, to a margin."""
    first = math.ceil((float(temperature_c.min()) - NODE_MARGIN_C - room_temperature_c) / step_c)
    last = math.floor((float(temperature_c.max()) + NODE_MARGIN_C - room_temperature_c) / step_c)
    if not 0 <= last - first < MAX_NODES:
        raise refused(f"{last - first + 1} nodes of {step_c:g} deg C: there must be 1 to {MAX_NODES}.")
    return room_temperature_c + step_c * np.arange(first, last + 1, dtype=np.float64)


def _design(
    weights: FloatArray, output: FloatArray, powers: NDArray[np.int_]
) -> tuple[FloatArray, FloatArray]:
    """Columns node by node, power by power, of outputs scaled to 1, and what undoes the scale."""
    scale = float(np.abs(output).max()) or 1.0
    shape = (output[:, None] / scale) ** powers
    design = (weights[:, :, None] * shape[:, None, :]).reshape(len(weights), -1)
    return design, np.tile(scale ** -powers.astype(np.float64), weights.shape[1])


def _decomposed(
    design: FloatArray, node_c: FloatArray, powers: NDArray[np.int_], axis: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Singular value decomposition; refuses a design that leaves a coefficient open, and names it."""
    left, strength, right = (
        np.asarray(part, dtype=np.float64) for part in np.linalg.svd(design, full_matrices=False)
    )
    if strength[-1] <= MIN_STRENGTH * strength[0]:
        open_part = np.abs(right[-1]).reshape(len(node_c), len(powers))
        node, _ = np.unravel_index(int(open_part.argmax()), open_part.shape)
        terms = [
            POWER_WORDS[2 - int(p)] for p, part in zip(powers, open_part[node], strict=True) if part > 0.1
        ]
        raise refused(
            f"At {node_c[node]:g} deg C the inputs of axis {axis} do not tell {' from '.join(terms)} "
            f"(condition {float(strength[0] / max(strength[-1], 1e-300)):.2g}): for a quadratic each axis "
            "needs -1 g, 0 and +1 g there, for a line two of them."
        )
    return left, strength, right


def _powers(output: FloatArray) -> FloatArray:
    """N^2, N, 1 of each axis, shape (m, 3, 3)."""
    return np.stack([output**2, output, np.ones_like(output)], axis=-1)


def refused(what: str) -> CalibrationError:
    """The error of this method."""
    return CalibrationError(
        what,
        where="temperature compensation",
        fault=Fault.DATA,
        remedy="look at the thermal run: its temperatures, its poses and its room-temperature part.",
    )
