"""Fit of a thermal RC network to measured warm-ups, and which cooling scheme it shows (paper 2, 2.1).

    C dT/dt = P - L (T - T_ambient),   L = sum_e G_e d_e d_e^T

C: heat capacities of the nodes (J/K), G_e: conductances of the edges (W/K), d_e: +1 at one end, -1 at the
other (ambient has no row). Power and ambient are constant during a warm-up, so the response is a sum of
exponentials in the eigenvectors of C^-1/2 L C^-1/2, evaluated in closed form.

Powers must be known: temperatures alone tell the ratios of P, G and C only. Radiation and what else is
not proportional to a temperature difference is left out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, brentq, least_squares

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.coloured_residuals import weigh_colours
from calibration.algorithms.uncertainty_budget import t_inflation
from protocol.errors import CalibrationError, Fault

AMBIENT = "ambient"
MAX_EVALUATIONS = 300
STARTS = (1.0, 0.2, 5.0)
"""Factors on the guess of the capacities that the fit is started from; the best end counts."""
MAX_LOG_UNCERTAINTY = 1.0
"""A parameter known to no better than a factor e is not told by the data."""
SETTLED_PART = 0.05
"""A warm-up is near steady when this part of the rise is still missing."""
BOUNDARY_SIGMAS = 2.0
_LOG_STEP = 1e-4
NO_NOISE_K = 1e-6
"""Residuals below this are rounding, not noise whose memory could be told."""


@dataclass(frozen=True)
class WarmUp:
    """One record with constant powers.

    Attributes:
        time_s: shape (k,), from the instant that the powers came on, ascending.
        temperature_c: shape (k, n); a node without a sensor is a column of NaN.
        power_w: heat of each node, shape (n,).
        ambient_c: of the air or the mounting plate.
    """

    time_s: FloatArray
    temperature_c: FloatArray
    power_w: FloatArray
    ambient_c: float


@dataclass(frozen=True)
class ThermalNetwork:
    """A fitted network.

    Attributes:
        nodes, edges: as asked for; an edge is a pair of nodes, or of a node and `AMBIENT`.
        capacity_j_k: C, shape (n,).
        conductance_w_k: G, shape (e,).
        log_covariance: of (ln C, ln G), shape (n + e, n + e): its diagonal is squared relative uncertainties.
        residual_rms_k: of the measured temperatures.
        degrees_of_freedom: measured values less parameters (the warm-ups' first temperatures are some).
    """

    nodes: tuple[str, ...]
    edges: tuple[tuple[str, str], ...]
    capacity_j_k: FloatArray
    conductance_w_k: FloatArray
    log_covariance: FloatArray
    residual_rms_k: float
    degrees_of_freedom: int

    @property
    def capacity_standard_uncertainty(self) -> FloatArray:
        """u(C), shape (n,), J/K."""
        return self.capacity_j_k * np.sqrt(np.diag(self.log_covariance)[: len(self.nodes)])

    @property
    def conductance_standard_uncertainty(self) -> FloatArray:
        """u(G), shape (e,), W/K."""
        return self.conductance_w_k * np.sqrt(np.diag(self.log_covariance)[len(self.nodes) :])

    def figures(self, power_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """C, G, steady rises and the settling time in one vector (2 n + e + 1,), SI, and its covariance.

        The derived figures' part is by central differences in ln C, ln G; its rank is that of C and G.
        """
        logs = np.log(np.r_[self.capacity_j_k, self.conductance_w_k])

        def at(parameters: FloatArray) -> FloatArray:
            capacity, conductance = np.split(np.exp(parameters), [len(self.nodes)])
            other = replace(self, capacity_j_k=capacity, conductance_w_k=conductance)
            rise, _ = other.steady_rise_k(power_w)
            return np.concatenate([capacity, conductance, rise, [other.settling_s(power_w)]])

        steps = _LOG_STEP * np.eye(len(logs))
        jacobian = np.stack([(at(logs + h) - at(logs - h)) / (2.0 * _LOG_STEP) for h in steps], axis=1)
        return at(logs), jacobian @ self.log_covariance @ jacobian.T

    def steady_rise_k(self, power_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rise above ambient in the end, shape (n,), K, and its standard uncertainty: inv(L) P."""
        incidence = _incidence(self.nodes, self.edges)
        inverse = np.linalg.inv((incidence.T * self.conductance_w_k) @ incidence)
        rise = np.asarray(inverse @ power_w, dtype=np.float64)
        # d rise / d ln G_e = -inv(L) d_e G_e (d_e . rise)
        gradient = -(inverse @ incidence.T) * (self.conductance_w_k * (incidence @ rise))
        of_edges = self.log_covariance[len(self.nodes) :, len(self.nodes) :]
        variance = np.einsum("ne,ef,nf->n", gradient, of_edges, gradient)
        return rise, np.sqrt(np.maximum(variance, 0.0))

    def rise_k(self, time_s: FloatArray, power_w: FloatArray, first_k: FloatArray) -> FloatArray:
        """Rise above ambient after powers came on, shape (k, n), K, from first rises (n,)."""
        incidence = _incidence(self.nodes, self.edges)
        return _response(incidence, self.capacity_j_k, self.conductance_w_k, time_s, power_w, first_k)

    def settling_s(self, power_w: FloatArray) -> float:
        """Time from ambient until the hottest node lacks only `SETTLED_PART` of its steady rise, s."""
        steady, _ = self.steady_rise_k(power_w)
        hottest = int(steady.argmax())
        incidence = _incidence(self.nodes, self.edges)
        laplacian = (incidence.T * self.conductance_w_k) @ incidence
        root = 1.0 / np.sqrt(self.capacity_j_k)
        slowest_s = 1.0 / float(np.linalg.eigvalsh(root[:, None] * laplacian * root).min())

        def missing(time_s: float) -> float:
            rise = self.rise_k(np.array([time_s]), power_w, np.zeros(len(self.nodes)))
            return float(1.0 - SETTLED_PART - rise[0, hottest] / steady[hottest])

        # Each mode's part is at most the whole, times what its eigenvector can weigh: 50 times is ample.
        return float(brentq(missing, 0.0, 50.0 * slowest_s))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class CoolingScheme:
    """A scheme and the rise of the hottest point above ambient that it is known by.

    Attributes:
        name: of the scheme.
        steady_rise_k: in the end.
        settling_s: until near steady; None: not known.
        source: simulated or measured, and where.
    """

    name: str
    steady_rise_k: float
    settling_s: float | None
    source: str


AIR, PASTE, POTTED = "air only", "paste from heat sources to housing", "housing filled with paste"
SIMULATED_SCHEMES = (
    CoolingScheme(AIR, 16.0, None, "paper 2, simulated, scheme 1"),
    CoolingScheme(PASTE, 8.0, None, "paper 2, simulated, scheme 2"),
    CoolingScheme(POTTED, 4.0, None, "paper 2, simulated, scheme 3"),
)
MEASURED_SCHEMES = (
    CoolingScheme(AIR, 20.0, 800.0, "paper 2, measured: more than 20 K, near steady at 800 s"),
    CoolingScheme(PASTE, 8.0, 300.0, "paper 2, measured: at most 8 K, steady at about 300 s"),
)


@dataclass(frozen=True)
class SchemeVerdict:
    """Which scheme a rise belongs to.

    Attributes:
        scheme: the nearest by ratio of the rises.
        clear: is the boundary to the next one (their geometric mean) further than `BOUNDARY_SIGMAS` u away?
        next_scheme: the other side of the nearest boundary.
    """

    scheme: CoolingScheme
    clear: bool
    next_scheme: CoolingScheme


def which_scheme(
    rise_k: float, standard_uncertainty_k: float, schemes: Sequence[CoolingScheme]
) -> SchemeVerdict:
    """The scheme of a hottest point's steady rise. It holds for the power that the schemes are known at.

    Raises:
        CalibrationError: fewer than two schemes, or a rise that is not positive.
    """
    if len(schemes) < 2 or not rise_k > 0 or not standard_uncertainty_k >= 0:
        raise refused("A verdict takes a rise above ambient and two schemes or more.")
    ranked = sorted(schemes, key=lambda scheme: scheme.steady_rise_k)
    boundaries = [math.sqrt(low.steady_rise_k * high.steady_rise_k) for low, high in pairwise(ranked)]
    place = sum(rise_k > boundary for boundary in boundaries)
    nearest = min(range(len(boundaries)), key=lambda index: abs(rise_k - boundaries[index]))
    clear = abs(rise_k - boundaries[nearest]) > BOUNDARY_SIGMAS * standard_uncertainty_k
    return SchemeVerdict(ranked[place], clear, ranked[nearest + 1 if place <= nearest else nearest])


def fit_thermal_network(
    warm_ups: Sequence[WarmUp], nodes: Sequence[str], edges: Sequence[tuple[str, str]]
) -> ThermalNetwork:
    """Fit C and G (and the first temperatures) to all warm-ups at once.

    Args:
        warm_ups: with n nodes each; noise is taken as alike on all sensors, white or with a memory.
        nodes: names, n.
        edges: pairs of names; every node must reach `AMBIENT`.

    Raises:
        CalibrationError: records or edges that do not fit, no power, a fit that does not end, or a
            capacity or conductance that the data do not tell (it is named).
    """
    incidence = _incidence(tuple(nodes), tuple(edges))
    _check(warm_ups, incidence)
    count = len(nodes) + len(edges)
    measured = np.concatenate([w.temperature_c.ravel() - w.ambient_c for w in warm_ups])
    seen = np.isfinite(measured)

    def residual(parameters: FloatArray) -> FloatArray:
        capacity, conductance = np.split(np.exp(parameters[:count]), [len(nodes)])
        first = parameters[count:].reshape(len(warm_ups), len(nodes))
        predicted = [
            _response(incidence, capacity, conductance, w.time_s, w.power_w, start).ravel()
            for w, start in zip(warm_ups, first, strict=True)
        ]
        return (np.concatenate(predicted) - measured)[seen]

    dof = int(seen.sum()) - count - len(warm_ups) * len(nodes)
    if dof < 3:
        raise refused("The warm-ups have fewer temperatures than the network has parameters.")
    best = _best_fit(residual, warm_ups, len(nodes), len(edges))
    jacobian = np.asarray(best.jac, dtype=np.float64)
    scatter = math.sqrt(2.0 * float(best.cost) / dof)
    covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-14)[:count, :count]
    log_covariance = np.asarray(covariance * (scatter * t_inflation(dof)) ** 2, dtype=np.float64)
    found = np.asarray(best.x, dtype=np.float64)[:count]
    names = [f"capacity of {node}" for node in nodes] + [f"conductance {a} - {b}" for a, b in edges]
    _refuse_untold(jacobian, log_covariance, names)
    if scatter > NO_NOISE_K:
        step, weighed = weigh_colours(jacobian, -residual(best.x), _series(warm_ups))
        found, log_covariance = found + step[:count], weighed[:count, :count]
        _refuse_untold(jacobian, log_covariance, names)
    capacity, conductance = np.split(np.exp(found), [len(nodes)])
    return ThermalNetwork(tuple(nodes), tuple(edges), capacity, conductance, log_covariance, scatter, dof)


def _series(warm_ups: Sequence[WarmUp]) -> list[tuple[NDArray[np.intp], FloatArray]]:
    """Rows among all temperatures that were seen, and times, of each sensor of each warm-up."""
    series: list[tuple[NDArray[np.intp], FloatArray]] = []
    begin = 0
    for record in warm_ups:
        seen = np.isfinite(record.temperature_c)
        place = begin + np.cumsum(seen.ravel()).reshape(seen.shape) - 1
        series += [(place[column, node], record.time_s[column]) for node, column in enumerate(seen.T)]
        begin += int(seen.sum())
    return series


def _best_fit(
    residual: Callable[[FloatArray], FloatArray], warm_ups: Sequence[WarmUp], node_count: int, edge_count: int
) -> OptimizeResult:
    """Least squares from a few guesses of the capacities; the best end that converged."""
    power = max(float(w.power_w.sum()) for w in warm_ups)
    rise = max(float(np.nanmax(w.temperature_c)) - w.ambient_c for w in warm_ups)
    span_s = max(float(np.ptp(w.time_s)) for w in warm_ups)
    conductance = power / max(rise, 1e-3)
    capacity = conductance * span_s / 4.0 / node_count
    first = np.concatenate(
        [np.where(np.isfinite(w.temperature_c[0]), w.temperature_c[0] - w.ambient_c, 0.0) for w in warm_ups]
    )
    ends: list[OptimizeResult] = []
    for factor in STARTS:
        logs = np.log(np.r_[np.full(node_count, factor * capacity), np.full(edge_count, conductance)])
        guess = np.concatenate([logs, first])
        low = np.concatenate([logs - 12.0, np.full(len(first), -np.inf)])
        high = np.concatenate([logs + 12.0, np.full(len(first), np.inf)])
        end = least_squares(residual, guess, bounds=(low, high), max_nfev=MAX_EVALUATIONS, xtol=1e-12)
        if end.success:
            ends.append(end)
    if not ends:
        raise refused(f"The fit did not end within {MAX_EVALUATIONS} evaluations.")
    return min(ends, key=lambda end: float(end.cost))


def _response(
    incidence: FloatArray,
    capacity: FloatArray,
    conductance: FloatArray,
    time_s: FloatArray,
    power_w: FloatArray,
    first_k: FloatArray,
) -> FloatArray:
    """Rises (k, n): steady + V exp(-lambda t) V^T (first - steady), in coordinates scaled by sqrt(C)."""
    laplacian = (incidence.T * conductance) @ incidence
    root = np.sqrt(capacity)
    rates, modes = np.linalg.eigh(laplacian / np.outer(root, root))
    steady = np.linalg.solve(laplacian, power_w)
    start = modes.T @ (root * (first_k - steady))
    return steady + (np.exp(-np.outer(time_s, rates)) * start) @ modes.T / root


def _incidence(nodes: tuple[str, ...], edges: tuple[tuple[str, str], ...]) -> FloatArray:
    """d_e as rows, shape (e, n).

    Raises:
        CalibrationError: unknown names, an edge from a node to itself, or a node that cannot reach ambient.
    """
    incidence = np.zeros((len(edges), len(nodes)))
    for row, edge in enumerate(edges):
        for name, sign in zip(edge, (1.0, -1.0), strict=True):
            if name != AMBIENT and name not in nodes:
                raise refused(f"'{name}' of the edge {edge[0]} - {edge[1]} is no node.")
            if name != AMBIENT:
                incidence[row, nodes.index(name)] += sign
    if len(edges) == 0 or not incidence.any(axis=1).all():
        raise refused("The network has no edge, or one from a node to itself.")
    lost = np.abs(np.linalg.svd(incidence)[2][np.linalg.matrix_rank(incidence) :])
    if len(lost):
        raise refused(f"'{nodes[int(lost[0].argmax())]}' has no path to {AMBIENT}.")
    return incidence


def _check(warm_ups: Sequence[WarmUp], incidence: FloatArray) -> None:
    if not warm_ups:
        raise refused("There is no warm-up.")
    nodes = incidence.shape[1]
    for number, record in enumerate(warm_ups, start=1):
        if record.temperature_c.shape != (len(record.time_s), nodes) or record.power_w.shape != (nodes,):
            raise refused(f"Warm-up {number} does not have {nodes} nodes.")
        if not np.isfinite(record.temperature_c).any():
            raise refused(f"Warm-up {number} has no temperature.")
        if (np.diff(record.time_s) <= 0).any() or not np.isfinite(record.time_s).all():
            raise refused(f"The time of warm-up {number} does not run forward.")
    if not any(float(record.power_w.sum()) > 0 for record in warm_ups):
        raise refused("No warm-up has a known power: temperatures alone tell ratios only.")


def _refuse_untold(jacobian: FloatArray, log_covariance: FloatArray, names: list[str]) -> None:
    """A direction that no temperature depends on, or a parameter that is loose by more than a factor e."""
    _, strength, right = np.linalg.svd(jacobian, full_matrices=False)
    blind = np.abs(right[-1, : len(names)])
    if strength[-1] <= 1e-8 * strength[0]:
        worst = int(blind.argmax())
    else:
        loose = np.sqrt(np.diag(log_covariance))
        worst = int(loose.argmax())
        if loose[worst] <= MAX_LOG_UNCERTAINTY:
            return
    raise refused(f"The warm-ups do not tell the {names[worst]}.")


def refused(what: str) -> CalibrationError:
    """The error of this method."""
    return CalibrationError(
        what,
        where="thermal network",
        fault=Fault.DATA,
        remedy="measure longer or at more nodes, change the powers between warm-ups, or ask for fewer edges.",
    )
