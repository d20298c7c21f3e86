"""What each deterministic effect must give, sample by sample, from its definition and nothing else.

Plain loops over Python floats. Nothing here is imported from an effect's module, and nothing of the effects'
arithmetic is shared: cross products are written out, recursions are solved by hand or by fine integration,
rotations are applied as matrices of the gimbals.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any

Row = list[float]
Oracle = Callable[[Any, Any, Any], list[Row]]


def cross(a: Any, b: Any) -> Row:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def each(change: Callable[[Any, Any, int, int, float], float]) -> Oracle:
    """y[k][i] = u + change(effect, stimulus, k, i, u)."""

    def oracle(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
        return [
            [float(u[i]) + change(effect, stimulus, k, i, float(u[i])) for i in range(3)]
            for k, u in enumerate(samples)
        ]

    return oracle


def coupled(field: str, source: Callable[[Any, Any, int, int], float]) -> Oracle:
    """y[k][i] = u + Σ_j matrix[i][j] source(samples, stimulus, k, j)."""

    def oracle(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
        matrix = getattr(effect, field)
        return [
            [u[i] + sum(matrix[i][j] * source(samples, stimulus, k, j) for j in range(3)) for i in range(3)]
            for k, u in enumerate(samples)
        ]

    return oracle


def temperature_excess(effect: Any, stimulus: Any, k: int) -> float:
    return min(max(float(stimulus.temperature_c[k]), -40.0), 85.0) - effect.reference_temperature_c


def polynomial(rows: Any, axis: int, excess: float) -> float:
    return sum(row[axis] * excess ** (power + 1) for power, row in enumerate(rows))


def difference(values: Any, times: Any, k: int) -> Row:
    """Backward difference of rows; nothing at the first one."""
    if k == 0:
        return [0.0] * len(values[0])
    elapsed = float(times[k] - times[k - 1])
    return [float(a - b) / elapsed for a, b in zip(values[k], values[k - 1], strict=True)]


def play_position(path: list[float], width: float) -> list[float]:
    """The play as a slider between two walls: the walls are at slider ± width; position by distance."""
    slider, positions = path[0], []
    for value in path:
        if value - slider > width:
            slider = value - width
        if slider - value > width:
            slider = value + width
        positions.append((value - slider) / width)
    return positions


def _thermal_hysteresis(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    at = play_position([float(t) for t in stimulus.temperature_c], effect.half_width_c)
    return [[u[i] + effect.amplitude_si[i] * p for i in range(3)] for u, p in zip(samples, at, strict=True)]


def _rate_hysteresis(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    at = [play_position([float(u[i]) for u in samples], effect.half_width_si) for i in range(3)]
    return [[u[i] + effect.amplitude_si[i] * at[i][k] for i in range(3)] for k, u in enumerate(samples)]


def _warm_up(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    since = float(stimulus.time_s[k]) - stimulus.power_on_s
    return effect.amplitude_si[i] * math.exp(-since / effect.time_constant_s) if since >= 0 else 0.0


def lag(values: list[float], period: float, tau: float) -> list[float]:
    """τ ẏ = u − y with u linear between samples: the ramp's solution from one sample to the next.

    From (u0, y0) with slope s: y(t) = u0 + s (t − τ) + (y0 − u0 + s τ) exp(−t / τ).
    """
    outputs = [values[0]]
    for before, now in itertools.pairwise(values):
        slope = (now - before) / period
        decay = math.exp(-period / tau)
        outputs.append(before + slope * (period - tau) + (outputs[-1] - before + slope * tau) * decay)
    return outputs


def _lag(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    columns = [
        lag([float(u[i]) for u in samples], stimulus.sample_period_s, effect.time_constant_s)
        for i in range(3)
    ]
    return [list(row) for row in zip(*columns, strict=True)]


def _vibration_rectification(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    period, time = stimulus.sample_period_s, effect.averaging_time_s
    columns = []
    for i in range(3):
        force = [float(u[i]) for u in samples]
        squares = [(f - m) ** 2 for f, m in zip(force, lag(force, period, time), strict=True)]
        means = lag(squares, period, time)
        columns.append([f + effect.coefficient_per_si[i] * m for f, m in zip(force, means, strict=True)])
    return [list(row) for row in zip(*columns, strict=True)]


def arm_force(stimulus: Any, k: int, arm: Any) -> Row:
    """ω̇ × r + ω (ω · r) − r ω²: the centripetal part by Lagrange's identity."""
    rate = [float(v) for v in stimulus.rate_rad_s[k]]
    tangential = cross(difference(stimulus.rate_rad_s, stimulus.time_s, k), arm)
    along = sum(w * r for w, r in zip(rate, arm, strict=True))
    square = sum(w * w for w in rate)
    return [t + w * along - r * square for t, w, r in zip(tangential, rate, arm, strict=True)]


def _size_effect(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    places = (effect.place_x_m, effect.place_y_m, effect.place_z_m)
    return [[u[i] + arm_force(stimulus, k, places[i])[i] for i in range(3)] for k, u in enumerate(samples)]


def _lever_arm(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    return [
        [v + c for v, c in zip(u, arm_force(stimulus, k, effect.arm_m), strict=True)]
        for k, u in enumerate(samples)
    ]


def _shock(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    rows, happened = [], False
    for u in samples:
        happened = happened or max(abs(v) for v in u) > effect.threshold_si
        rows.append([v + (b if happened else 0.0) for v, b in zip(u, effect.shift_si, strict=True)])
    return rows


def shifted(delay: Callable[[Any, Any, int], float]) -> Oracle:
    """The input at t − d by walking back along the samples."""

    def oracle(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
        times, rows = [float(t) for t in stimulus.time_s], []
        for k in range(len(samples)):
            wanted, j = times[k] - delay(effect, stimulus, k), k
            while j > 0 and times[j - 1] >= wanted:
                j -= 1
            if j == 0:
                rows.append([float(v) for v in samples[0]])
                continue
            share = (wanted - times[j - 1]) / (times[j] - times[j - 1])
            rows.append(
                [(1 - share) * a + share * b for a, b in zip(samples[j - 1], samples[j], strict=True)]
            )
        return rows

    return oracle


def _wrap(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    value = u
    while value >= effect.half_span_si:
        value -= 2 * effect.half_span_si
    while value < -effect.half_span_si:
        value += 2 * effect.half_span_si
    return value - u


def _tone(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    """As one cosine with a phase."""
    size = math.hypot(effect.cosine_si[i], effect.sine_si[i])
    phase = math.atan2(effect.sine_si[i], effect.cosine_si[i])
    return size * math.cos(2 * math.pi * effect.frequency_hz * float(stimulus.time_s[k]) - phase)


def about(axis: str, angle: float) -> list[Row]:
    """Passive rotation: coordinates turn by `angle` about one axis."""
    c, s = math.cos(angle), math.sin(angle)
    if axis == "x":
        return [[1, 0, 0], [0, c, s], [0, -s, c]]
    if axis == "y":
        return [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    return [[c, s, 0], [-s, c, 0], [0, 0, 1]]


def times(matrix: Any, vector: Any) -> Row:
    return [sum(m * v for m, v in zip(row, vector, strict=True)) for row in matrix]


def gimbal_axis(stimulus: Any, k: int, axis: str) -> Row:
    """e_x, Rx e_y, Rx Ry e_z."""
    _, middle, inner = (float(a) for a in stimulus.angles_rad[k])
    if axis == "inner":
        return [1.0, 0.0, 0.0]
    if axis == "middle":
        return times(about("x", inner), [0.0, 1.0, 0.0])
    return times(about("x", inner), times(about("y", middle), [0.0, 0.0, 1.0]))


def angle_of(stimulus: Any, k: int, axis: str) -> float:
    return float(stimulus.angles_rad[k][("outer", "middle", "inner").index(axis)])


def turned_by(rotation: Callable[[Any, Any, int], Row]) -> Oracle:
    """u − φ × u, and φ̇ for a rate."""

    def oracle(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
        rotations = [rotation(effect, stimulus, k) for k in range(len(samples))]
        rows = []
        for k, u in enumerate(samples):
            x, y, z = rotations[k]
            row = [u[0] + z * u[1] - y * u[2], u[1] + x * u[2] - z * u[0], u[2] + y * u[0] - x * u[1]]
            if effect.sensor == "gyro":
                row = [a + b for a, b in zip(row, difference(rotations, stimulus.time_s, k), strict=True)]
            rows.append(row)
        return rows

    return oracle


def _wobble(effect: Any, stimulus: Any, k: int) -> Row:
    at = effect.harmonic * angle_of(stimulus, k, effect.axis)
    pairs = zip(effect.cosine_rad, effect.sine_rad, strict=True)
    return [c * math.cos(at) + s * math.sin(at) for c, s in pairs]


def _eccentricity(effect: Any, stimulus: Any, k: int) -> Row:
    at = angle_of(stimulus, k, effect.axis)
    error = effect.cosine_rad * math.cos(at) + effect.sine_rad * math.sin(at)
    return [-error * e for e in gimbal_axis(stimulus, k, effect.axis)]


def _level(effect: Any, stimulus: Any, k: int) -> Row:
    outer, middle, inner = (float(a) for a in stimulus.angles_rad[k])
    since = float(stimulus.time_s[k]) - stimulus.power_on_s
    tilt = [rate * since for rate in effect.tilt_rate_rad_s]
    return times(about("x", inner), times(about("y", middle), times(about("z", outer), tilt)))


def _not_square(effect: Any, stimulus: Any, k: int) -> Row:
    _, middle, inner = (float(a) for a in stimulus.angles_rad[k])
    first = times(about("x", inner), times(about("y", middle), [effect.outer_middle_rad, 0.0, 0.0]))
    second = times(about("x", inner), [0.0, 0.0, effect.middle_inner_rad])
    return [a + b for a, b in zip(first, second, strict=True)]


def _remounted(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    x, y, z = effect.rotation_rad
    matrix = [[1, z, -y], [-z, 1, x], [y, -x, 1]]
    return [times(matrix, u) for u in samples]


def speed_of(stimulus: Any, k: int, axis: str) -> float:
    """Backward difference of a gimbal's angle; nothing at the first sample."""
    if k == 0:
        return 0.0
    turned = angle_of(stimulus, k, axis) - angle_of(stimulus, k - 1, axis)
    return turned / float(stimulus.time_s[k] - stimulus.time_s[k - 1])


def _ripple(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    rows = []
    for k, u in enumerate(samples):
        at = effect.harmonic * angle_of(stimulus, k, effect.axis)
        extra = speed_of(stimulus, k, effect.axis) * (
            effect.cosine * math.cos(at) + effect.sine * math.sin(at)
        )
        rows.append([v + extra * e for v, e in zip(u, gimbal_axis(stimulus, k, effect.axis), strict=True)])
    return rows


def _motor(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    at = effect.harmonic * angle_of(stimulus, k, effect.axis)
    return effect.cosine_t[i] * math.cos(at) + effect.sine_t[i] * math.sin(at)


def _crank(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    speed = speed_of(stimulus, k, "inner")
    second_harmonic = 1 - 2 * math.sin(angle_of(stimulus, k, "inner")) ** 2
    return -effect.ratio * effect.radius_m * speed * speed * second_harmonic * effect.stroke[i]


def _antenna(effect: Any, samples: Any, stimulus: Any) -> list[Row]:
    return [
        [v + c for v, c in zip(p, times(stimulus.dcm_local_from_body[k], effect.arm_m), strict=True)]
        for k, p in enumerate(samples)
    ]


def _quantised(effect: Any, stimulus: Any, k: int, i: int, u: float) -> float:
    return round(u / effect.quantum_si) * effect.quantum_si - u


ORACLES: dict[str, Oracle] = {
    "misalignment": coupled("misalignment_rad", lambda u, s, k, j: u[k][j]),
    "scale_factor_error": each(lambda e, s, k, i, u: e.scale_factor_error[i] * u),
    "bias": each(lambda e, s, k, i, u: e.bias_si[i]),
    "bias_temperature": each(
        lambda e, s, k, i, u: polynomial(e.coefficients_si_per_c, i, temperature_excess(e, s, k))
    ),
    "scale_factor_temperature": each(
        lambda e, s, k, i, u: u * polynomial(e.coefficients_per_c, i, temperature_excess(e, s, k))
    ),
    "misalignment_temperature": lambda e, u, s: [
        [
            row[i]
            + temperature_excess(e, s, k) * sum(e.misalignment_rad_per_c[i][j] * row[j] for j in range(3))
            for i in range(3)
        ]
        for k, row in enumerate(u)
    ],
    "temperature_rate": each(
        lambda e, s, k, i, u: (
            e.coefficient_rad_per_c[i] * difference([[t] for t in s.temperature_c], s.time_s, k)[0]
        )
    ),
    "thermal_hysteresis": _thermal_hysteresis,
    "warm_up": each(_warm_up),
    "scale_factor_asymmetry": each(lambda e, s, k, i, u: e.asymmetry[i] * (u if u > 0 else -u)),
    "scale_factor_nonlinearity": each(lambda e, s, k, i, u: e.cubic[i] * u * u * u),
    "even_nonlinearity": each(lambda e, s, k, i, u: e.square[i] * u * u),
    "quadratic_nonlinearity": each(lambda e, s, k, i, u: e.square[i] * u * u),
    "odd_quadratic_nonlinearity": each(lambda e, s, k, i, u: e.odd_square[i] * (u * u if u > 0 else -u * u)),
    "cubic_nonlinearity": each(lambda e, s, k, i, u: e.cubic[i] * u * u * u),
    "dead_band": each(
        lambda e, s, k, i, u: -e.depth[i] * u if -e.half_width_si < u < e.half_width_si else 0.0
    ),
    "rate_hysteresis": _rate_hysteresis,
    "g_sensitivity": coupled("acc", lambda u, s, k, j: float(s.specific_force_m_s2[k][j])),
    "g2_sensitivity": coupled("acc_squared", lambda u, s, k, j: float(s.specific_force_m_s2[k][j]) ** 2),
    "supply_sensitivity": each(lambda e, s, k, i, u: e.per_volt_si[i] * (float(s.supply_v[k]) - e.nominal_v)),
    "magnetic_sensitivity": coupled("field", lambda u, s, k, j: float(s.field_t[k][j])),
    "cross_axis_sensitivity": coupled("cross", lambda u, s, k, j: u[k][j]),
    "vibration_rectification": _vibration_rectification,
    "size_effect": _size_effect,
    "shock_bias_shift": _shock,
    "bandwidth": _lag,
    "chamber_lag": _lag,
    "saturation": each(lambda e, s, k, i, u: min(max(u, -e.range_si), e.range_si) - u),
    "quantization": each(_quantised),
    "hard_iron": each(lambda e, s, k, i, u: e.field_t[i]),
    "soft_iron": coupled("matrix", lambda u, s, k, j: u[k][j]),
    "current_coupling": each(lambda e, s, k, i, u: e.per_ampere_t[i] * float(s.supply_current_a[k])),
    "mains_interference": each(_tone),
    "aliasing": each(_tone),
    "latency": shifted(lambda e, s, k: e.latency_s),
    "clock_step": shifted(lambda e, s, k: e.step_s if s.time_s[k] >= e.at_s else 0.0),
    "antenna_lever_arm": _antenna,
    "fixed_delay": shifted(lambda e, s, k: e.delay_s),
    "clock_drift": shifted(lambda e, s, k: e.relative_rate * (float(s.time_s[k]) - s.power_on_s)),
    "counter_wrap": each(_wrap),
    "wobble": turned_by(_wobble),
    "rate_ripple": _ripple,
    "encoder_eccentricity": turned_by(_eccentricity),
    "remount_misalignment": _remounted,
    "earth_rate": each(lambda e, s, k, i, u: e.share * float(s.earth_rate_rad_s[k][i])),
    "lever_arm": _lever_arm,
    "motor_field": each(_motor),
    "chamber_gradient": each(lambda e, s, k, i, u: e.share[i] * (u - e.room_c)),
    "level_drift": turned_by(_level),
    "non_orthogonality": turned_by(_not_square),
    "rate_scale_factor": each(lambda e, s, k, i, u: e.share * u),
    "crank_geometry": each(_crank),
}
