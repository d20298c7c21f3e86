"""Bias over temperature from slow ramps both ways: the mean curve, hysteresis, what follows dT/dt.

    y = f(T) + k dT/dt + d h(T) / 2,   d = +1 after warming, -1 after cooling

f: cubic spline, the mean of both branches; h: warming less cooling, straight between knots and 0
at the temperatures of the turns, where one branch becomes the other; k: the sensitivity to the speed of the
temperature (Shupe's effect in a fibre coil). On a ramp of constant speed k dT/dt and h look alike; where a
soak begins dT/dt dies away and h stays, and that tells them apart. Fitted with the noise's memory
(`correlated_fit`).
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.correlated_fit import Blocks, CorrelatedFit, SlowTerms, fit_correlated, refused
from calibration.algorithms.temperature_compensation import hat_weights
from calibration.algorithms.thermal_soaks import spline_weights

CURVE_STEP_C = 10.0
LOOP_STEP_C = 15.0
MIN_SPAN_C = 20.0
MOVING_PART = 0.3
"""Of the fastest change of temperature: below it the unit soaks, and keeps the direction that it had."""
TABLE_STEP_C = 5.0
WHERE = "temperature ramp"


@dataclass(frozen=True)
class RampFit:
    """What m channels do over temperature.

    Attributes:
        rate_si_s_per_c: k, shape (m,), SI of the output per degC/s.
        hysteresis_si: warming less cooling, mean over the temperatures that both have, shape (m,).
        sensitivity_si_per_c: rise of the mean curve from its coldest to its hottest, per degC, shape (m,).
        covariance: of these three, shape (m, 3, 3).
        temperature_c: shape (t,), where the curves are told.
        curve_si, curve_u_si: f less its value at the middle temperature, shape (t, m), and u.
        loop_si, loop_u_si: h, shape (t, m), and u.
        span_c: coldest and hottest.
        fit: with residuals and noise.
    """

    rate_si_s_per_c: FloatArray
    hysteresis_si: FloatArray
    sensitivity_si_per_c: FloatArray
    covariance: FloatArray
    temperature_c: FloatArray
    curve_si: FloatArray
    curve_u_si: FloatArray
    loop_si: FloatArray
    loop_u_si: FloatArray
    span_c: tuple[float, float]
    fit: CorrelatedFit


def fit_ramp(blocks: Blocks, temperature_c: FloatArray, known_slow: SlowTerms | None = None) -> RampFit:
    """Fit all channels of one sensor.

    Args:
        blocks: means of the outputs over equal stretches, in time order, (k, m).
        temperature_c: of the sensor in each block, shape (k,).
        known_slow: see `correlated_fit`.

    Raises:
        CalibrationError: the temperature does not go both ways over `MIN_SPAN_C`, or what is asked for
            cannot be told apart.
    """
    low, high = float(temperature_c.min()), float(temperature_c.max())
    if not high - low >= MIN_SPAN_C:
        raise refused(
            f"The sensor's temperature spans {high - low:.1f} degC only.",
            WHERE,
            f"ramp over {MIN_SPAN_C:g} degC or more, both ways.",
        )
    speed = np.asarray(np.gradient(temperature_c, blocks.middle_s), dtype=np.float64)
    direction = _direction(speed)
    both = _both_ways(temperature_c, direction)
    knots = _even(low, high, CURVE_STEP_C)
    corners = _even(low, high, LOOP_STEP_C)
    curve = spline_weights(knots, temperature_c)
    loop = 0.5 * direction[:, None] * hat_weights(corners, temperature_c)[:, 1:-1]
    names = (
        *(f"bias at {knot:.0f} degC" for knot in knots),
        "what follows the speed of the temperature",
        *(f"hysteresis at {corner:.0f} degC" for corner in corners[1:-1]),
    )
    design = np.column_stack([curve, speed, loop])
    fit = fit_correlated(design, blocks, names, WHERE, known_slow)
    count, terms = len(knots), design.shape[1]
    steps = np.arange(math.ceil(low / TABLE_STEP_C), math.floor(high / TABLE_STEP_C) + 1, dtype=np.float64)
    table = np.asarray(steps * TABLE_STEP_C, dtype=np.float64)
    middle = np.array([0.5 * (low + high)])
    to_curve, to_loop = np.zeros((len(table), terms)), np.zeros((len(table), terms))
    to_curve[:, :count] = spline_weights(knots, table) - spline_weights(knots, middle)
    to_loop[:, count + 1 :] = hat_weights(corners, table)[:, 1:-1]
    figures = np.zeros((3, terms))
    figures[0, count] = 1.0
    grid = np.linspace(*both, 201)
    figures[1, count + 1 :] = hat_weights(corners, grid)[:, 1:-1].mean(axis=0)
    ends = spline_weights(knots, np.array([low, high]))
    figures[2, :count] = (ends[1] - ends[0]) / (high - low)
    values = fit.values @ figures.T
    return RampFit(
        rate_si_s_per_c=values[:, 0],
        hysteresis_si=values[:, 1],
        sensitivity_si_per_c=values[:, 2],
        covariance=np.einsum("ap,mpq,bq->mab", figures, fit.covariance, figures),
        temperature_c=table,
        curve_si=to_curve @ fit.values.T,
        curve_u_si=_uncertainty(to_curve, fit),
        loop_si=to_loop @ fit.values.T,
        loop_u_si=_uncertainty(to_loop, fit),
        span_c=(low, high),
        fit=fit,
    )


def _uncertainty(figures: FloatArray, fit: CorrelatedFit) -> FloatArray:
    return np.sqrt(np.maximum(np.einsum("tp,mpq,tq->tm", figures, fit.covariance, figures), 0.0))


def _direction(speed: FloatArray) -> FloatArray:
    """+1 or -1 after the last motion; at the beginning that of the first one."""
    moving = np.abs(speed) > MOVING_PART * float(np.quantile(np.abs(speed), 0.9))
    if not (moving & (speed > 0)).any() or not (moving & (speed < 0)).any():
        raise refused("The temperature goes one way only.", WHERE, "ramp up and down.")
    rows = np.flatnonzero(moving)
    latest = np.clip(np.searchsorted(rows, np.arange(len(speed)), side="right") - 1, 0, None)
    return np.sign(speed[rows[latest]])


def _both_ways(temperature_c: FloatArray, direction: FloatArray) -> tuple[float, float]:
    """Temperatures between which both branches lie."""
    up, down = temperature_c[direction > 0], temperature_c[direction < 0]
    low, high = max(float(up.min()), float(down.min())), min(float(up.max()), float(down.max()))
    if not high - low >= MIN_SPAN_C:
        raise refused(
            f"Both ways have only {max(high - low, 0.0):.1f} degC in common.",
            WHERE,
            "ramp as far down as up.",
        )
    return low, high


def _even(low: float, high: float, step: float) -> FloatArray:
    return np.linspace(low, high, max(3, round((high - low) / step) + 1), dtype=np.float64)
