# pyright: strict
"""What the belief predicts: y = M u + b behind one pole, u from the stand's report and the Earth's rate."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import EffectState, FloatArray
from dut_emulator.effects.recursions import first_order_lag
from dut_emulator.gimbal_geometry import EARTH_RATE_RAD_S, Attitude, lab_from_east_north_up
from gap_diagnosis.belief import TriadBelief
from gap_diagnosis.holes import stretches
from gap_diagnosis.stand_at_unit import StandReport

SETTLED_TIME_CONSTANTS = 7.0
"""After a hole the filter is not settled: so long nothing is predicted (e⁻⁷ of a step is left)."""


def earth_rate_in_body(report: StandReport, site: Mapping[str, float]) -> FloatArray | None:
    """(n, 3) from gimbal angles or a vehicle's attitude; None where place or attitude is not told.

    Gimbals: `gimbal_geometry`, laboratory y at `heading_deg` east of north. Vehicle: yaw clockwise from
    north, pitch nose up, roll right side down; body x forward, y left, z up.
    """
    if "latitude_deg" not in site:
        return None
    latitude = math.radians(site["latitude_deg"])
    north, up = EARTH_RATE_RAD_S * math.cos(latitude), EARTH_RATE_RAD_S * math.sin(latitude)
    if report.angles_rad is not None and not report.is_crank:
        lab = lab_from_east_north_up(np.array([0.0, north, up]), site.get("heading_deg", 0.0))
        return Attitude(report.angles_rad).into_body(lab)
    if report.attitude_rad is None:
        return None
    (sr, sp, sy), (cr, cp, cy) = np.sin(report.attitude_rad.T), np.cos(report.attitude_rad.T)
    along_north = (cp * cy, cr * sy - sr * sp * cy, -sr * sy - cr * sp * cy)
    along_up = (sp, sr * cp, cr * cp)
    return np.stack([north * n + up * u for n, u in zip(along_north, along_up, strict=True)], axis=1)


def gravity_in_body(report: StandReport, site: Mapping[str, float]) -> FloatArray | None:
    """(n, 3) specific force of a unit at the stand's centre, from gimbal angles; None where not told."""
    if report.angles_rad is None or report.is_crank or "gravity_m_s2" not in site:
        return None
    return Attitude(report.angles_rad).up(site["gravity_m_s2"])


def predicted_si(
    acting_si: FloatArray, belief: TriadBelief, period_s: float, piece: NDArray[np.int64]
) -> FloatArray:
    """(n, 3) M u + b behind the believed pole, settled at the beginning of each piece.

    Exact for inputs that are straight between samples. Where a piece follows a hole, the first few time
    constants are NaN: nobody knows what the filter held.

    Args:
        acting_si: (n, 3) u, NaN where the stand says nothing.
        belief: of this triad.
        period_s: of the rows.
        piece: (n,) rows of one number follow each other.
    """
    linear = acting_si @ belief.matrix.T
    linear += belief.bias_si
    if not belief.bandwidth_hz:
        return linear
    time_constant_s = 1.0 / (2.0 * math.pi * belief.bandwidth_hz)
    unsettled = math.ceil(SETTLED_TIME_CONSTANTS * time_constant_s / period_s)
    out = np.full(linear.shape, np.nan, order="F")
    for first, last in stretches(piece):
        if np.isfinite(linear[first:last]).all():
            out[first:last] = first_order_lag(
                linear[first:last], period_s, time_constant_s, EffectState(), "belief"
            )
            if first > 0:
                out[first : min(first + unsettled, last)] = np.nan
    return out
