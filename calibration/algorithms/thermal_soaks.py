"""sigma(N, T) from soaks: every pose at every soak temperature, room temperature among or between them.

    N_p(T) = N_p(T_room) + sigma(N_p, T),   sigma = a(T) N^2 + b(T) N + c(T),   sigma(N, T_room) = 0

(paper 2, eqs (2), (3)). N_p(T_room), the output of pose p of one mounting at room temperature, is not
measured apart but estimated with the rest: nothing is compared across mountings or power-ons, so that
mounting a unit anew costs nothing, and no soak has to be at room temperature.

a(T), b(T), c(T) are cubic splines through the soak temperatures, tabulated at nodes every 5 deg C
from room temperature and straight between those. What soaks further apart than the nodes leave open is told
by the difference of the spline from straight lines; it is in the uncertainties (half width of a uniform
distribution).

The powers that an axis gets are those that its inputs tell: three different inputs tell the square, two the
slope, one the constant alone.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.correlated_fit import Blocks, SlowTerms, fit_correlated
from calibration.algorithms.temperature_compensation import (
    NODE_MARGIN_C,
    NODE_STEP_C,
    Order,
    TemperatureModel,
    hat_weights,
    refused,
    whole_nodes,
)

SAME_SOAK_C = 1.5
"""Readings nearer than this in temperature are of one soak."""
SAME_INPUT = 0.05
"""Inputs of an axis nearer than this part of its span are one input."""
MIN_SOAKS = 3
AXES = "xyz"


@dataclass(frozen=True)
class SoakReadings:
    """Means at rest or at a steady rate, in time order within each power-on.

    Attributes:
        output: N, shape (m, 3), SI.
        temperature_c: of the sensor, shape (m,).
        pose: number of the pose (or rate) of one mounting, shape (m,). The same pose in another mounting
            has another number.
        middle_s, duration_s: shape (m,), on one clock; power-ons lie far apart on it.
    """

    output: FloatArray
    temperature_c: FloatArray
    pose: NDArray[np.intp]
    middle_s: FloatArray
    duration_s: FloatArray


@dataclass(frozen=True)
class SoakFit:
    """A fitted model and what it rests on.

    Attributes:
        model: nodes every 5 deg C. Its covariance holds the noise with its memory, what the model does not
            follow, and the interpolation.
        soak_c: temperatures that the splines go through, shape (k,).
        powers: of each axis, descending: (2, 1, 0), (1, 0) or (0,).
        residual_si: shape (m, 3).
        spline_change_si: largest difference of the splines from straight lines at a node, at the outputs
            seen, shape (3,).
        noise: of each axis, in words.
    """

    model: TemperatureModel
    soak_c: FloatArray
    powers: tuple[tuple[int, ...], ...]
    residual_si: FloatArray
    spline_change_si: FloatArray
    noise: tuple[str, ...]


def fit_soaks(
    readings: SoakReadings,
    room: TriadCoefficients,
    room_temperature_c: float,
    known_slow: SlowTerms | None = None,
    highest: Order = "quadratic",
) -> SoakFit:
    """Fit sigma of three axes.

    Args:
        readings: at three soak temperatures or more, both sides of room temperature.
        room: M, D; frozen.
        room_temperature_c: that they were found at.
        known_slow: see `correlated_fit`; None: from the data.
        highest: 'linear' leaves the square out.

    Raises:
        CalibrationError: too few soaks, room temperature not among them, no pose at two soaks, values that
            are not finite.
    """
    knots = soak_temperatures(readings.temperature_c)
    if len(knots) < MIN_SOAKS:
        raise refused(f"{len(knots)} soak temperatures: there must be {MIN_SOAKS} or more.")
    if not knots[0] - NODE_MARGIN_C <= room_temperature_c <= knots[-1] + NODE_MARGIN_C:
        raise refused(
            f"Room temperature ({room_temperature_c:.1f} deg C) is not within the soaks "
            f"({knots[0]:.1f} to {knots[-1]:.1f} deg C)."
        )
    nodes = whole_nodes(knots[[0, -1]], room_temperature_c, NODE_STEP_C)
    found = [
        _axis(readings, axis, knots, nodes, room_temperature_c, known_slow, highest) for axis in range(3)
    ]
    model = TemperatureModel(
        room=room,
        node_c=nodes,
        coefficients=np.stack([one.coefficients for one in found], axis=1),
        covariance=np.stack([one.covariance for one in found]),
        residual_rms_si=np.array([one.residual_rms for one in found]),
        degrees_of_freedom=min(one.degrees_of_freedom for one in found),
        left_out=0,
    )
    return SoakFit(
        model=model,
        soak_c=knots,
        powers=tuple(one.powers for one in found),
        residual_si=np.stack([one.residual for one in found], axis=1),
        spline_change_si=np.array([one.spline_change for one in found]),
        noise=tuple(one.noise for one in found),
    )


def soak_temperatures(temperature_c: FloatArray) -> FloatArray:
    """Means of the clusters that the readings' temperatures form, ascending."""
    ordered = np.sort(temperature_c)
    cuts = np.flatnonzero(np.diff(ordered) > SAME_SOAK_C) + 1
    return np.array([float(part.mean()) for part in np.split(ordered, cuts)])


def spline_weights(knots: FloatArray, places: FloatArray) -> FloatArray:
    """Weights (m, k) of the values at the knots (k,) in a cubic spline at the places (m,).

    Its third derivative does not jump at the second and the second last knot: any cubic is met, also at the
    ends. Beyond the end knots it runs straight on.
    """
    step = np.diff(knots)
    second = _second_derivatives(step)
    place = np.clip(np.searchsorted(knots, places) - 1, 0, len(knots) - 2)
    along = (places - knots[place]) / step[place]
    inside = np.clip(along, 0.0, 1.0)
    before, width = 1.0 - inside, step[place]
    unit = np.eye(len(knots))
    bend = (width**2 / 6.0)[:, None]
    weights = before[:, None] * unit[place] + inside[:, None] * unit[place + 1]
    weights += bend * (before**3 - before)[:, None] * second[place]
    weights += bend * (inside**3 - inside)[:, None] * second[place + 1]
    slope = unit[place + 1] - unit[place] + bend * (1.0 - 3.0 * before**2)[:, None] * second[place]
    slope += bend * (3.0 * inside**2 - 1.0)[:, None] * second[place + 1]
    return weights + (along - inside)[:, None] * slope


def _second_derivatives(step: FloatArray) -> FloatArray:
    """Of the spline at its knots (k, k), for a one at each knot; k - 1 steps between the knots."""
    count = len(step) + 1
    if count == 2:
        return np.zeros((2, 2))
    system, right = np.zeros((count, count)), np.zeros((count, count))
    for row in range(1, count - 1):
        a, b = step[row - 1], step[row]
        system[row, row - 1 : row + 2] = a / 6.0, (a + b) / 3.0, b / 6.0
        right[row, row - 1 : row + 2] = 1.0 / a, -1.0 / a - 1.0 / b, 1.0 / b
    if count == 3:  # a parabola
        system[0, :2], system[2, 1:] = (1.0, -1.0), (1.0, -1.0)
    else:
        system[0, :3] = -1.0 / step[0], 1.0 / step[0] + 1.0 / step[1], -1.0 / step[1]
        system[-1, -3:] = -1.0 / step[-2], 1.0 / step[-2] + 1.0 / step[-1], -1.0 / step[-1]
    return np.asarray(np.linalg.solve(system, right), dtype=np.float64)


@dataclass(frozen=True)
class _Axis:
    coefficients: FloatArray  # (nodes, 3): a, b, c
    covariance: FloatArray  # (3 nodes, 3 nodes)
    residual: FloatArray  # (m,)
    residual_rms: float
    degrees_of_freedom: int
    powers: tuple[int, ...]
    spline_change: float
    noise: str


def _axis(
    readings: SoakReadings,
    axis: int,
    knots: FloatArray,
    nodes: FloatArray,
    room_c: float,
    known_slow: SlowTerms | None,
    highest: Order,
) -> _Axis:
    output = readings.output[:, axis]
    least = SAME_INPUT * float(np.ptp(readings.output, axis=0).max())
    powers = told_powers(output, readings.pose, highest, least)
    scale = float(np.abs(output).max()) or 1.0
    anchor = int(np.abs(knots - room_c).argmin())
    free = np.arange(len(knots)) != anchor
    basis = _anchored(spline_weights(knots, readings.temperature_c), knots, room_c, anchor)[:, free]
    shape = (output[:, None] / scale) ** np.array(powers)
    poses, pose = np.unique(readings.pose, return_inverse=True)
    design = np.hstack(
        [(basis[:, :, None] * shape[:, None, :]).reshape(len(output), -1), np.eye(len(poses))[pose]]
    )
    names = [
        f"{('constant', 'slope', 'square')[power]} of axis {AXES[axis]} at {knot:.0f} deg C"
        for knot in knots[free]
        for power in powers
    ] + [f"pose {number + 1}" for number in range(len(poses))]
    blocks = Blocks(readings.middle_s, readings.duration_s, output[:, None])
    fit = fit_correlated(design, blocks, names, "temperature compensation", known_slow)
    count = int(free.sum()) * len(powers)
    theta, covariance = fit.values[0, :count], fit.covariance[0, :count, :count]
    scales = np.tile(scale ** -np.array(powers, dtype=np.float64), int(free.sum()))
    theta, covariance = theta * scales, covariance * np.outer(scales, scales)
    cubic = _anchored(spline_weights(knots, nodes), knots, room_c, anchor)[:, free]
    straight = hat_weights(knots, nodes)
    at_room = hat_weights(knots, np.array([room_c]))
    straight = (straight - straight[:, [anchor]] / at_room[0, anchor] * at_room)[:, free]
    place = 3 * np.arange(len(nodes))[:, None] + (2 - np.array(powers))
    to_nodes = np.zeros((3 * len(nodes), count))
    bent = np.zeros(3 * len(nodes))
    for k in range(len(powers)):
        to_nodes[place[:, k], k :: len(powers)] = cubic
        bent[place[:, k]] = (cubic - straight) @ theta[k :: len(powers)]
    values = (to_nodes @ theta).reshape(len(nodes), 3)
    values[np.abs(nodes - room_c) < 1e-9] = 0.0
    told = to_nodes @ covariance @ to_nodes.T + np.diag(bent**2 / 3.0)
    levels = np.array([output.min(), output.max(), 0.0])[:, None] ** np.array([2, 1, 0])
    freedom = fit.degrees_of_freedom
    return _Axis(
        coefficients=values,
        covariance=told,
        residual=fit.residuals[:, 0],
        residual_rms=math.sqrt(float((fit.residuals**2).sum()) / freedom),
        degrees_of_freedom=freedom,
        powers=powers,
        spline_change=float(np.abs(bent.reshape(len(nodes), 3) @ levels.T).max()),
        noise=fit.noise[0],
    )


def _anchored(weights: FloatArray, knots: FloatArray, room_c: float, anchor: int) -> FloatArray:
    """Weights of the knots after that of `anchor` was chosen so that the spline is 0 at room temperature."""
    at_room = spline_weights(knots, np.array([room_c]))[0]
    return weights - weights[:, [anchor]] * (at_room / at_room[anchor])


def told_powers(
    output: FloatArray, pose: NDArray[np.intp], highest: Order, least_span: float = 0.0
) -> tuple[int, ...]:
    """Powers of N that the poses' different outputs tell, descending.

    An axis whose outputs span less than `least_span`, or than they scatter within a pose, has one input: what
    reaches it over its misalignment is no excitation.
    """
    means = np.sort([float(output[pose == number].mean()) for number in np.unique(pose)])
    scatter = max(float(np.ptp(output[pose == number])) for number in np.unique(pose))
    span = float(np.ptp(means))
    if span <= max(2.0 * scatter, least_span):
        return (0,)
    different = 1 + int((np.diff(means) > SAME_INPUT * span).sum())
    return (2, 1, 0) if different > 2 and highest == "quadratic" else (1, 0)
