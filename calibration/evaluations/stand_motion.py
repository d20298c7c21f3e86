"""What the stand did at the unit's sampling times: rate, attitude, Earth rate and gravity in body axes.

Attitude comes from the gimbal angles, body from laboratory = Rx(inner) Ry(middle) Rz(outer), z up and
y at the azimuth `site.heading_deg`; Earth rate from them and `site.latitude_deg`. Nothing is filled across
a hole in the stand's stream: motion is NaN there, and what rests on it is not used.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import earth_rate_ned
from calibration.evaluations.method_evaluation import refuse_unjoined, refused, stream_with
from protocol.recordings import Recording

RATES = ("rate_x", "rate_y", "rate_z")
ANGLES = ("angle_outer", "angle_middle", "angle_inner")
HOLE_PERIODS = 3.5
"""Times of the stand further apart than so many of its periods are a hole."""
MAX_DISAGREEMENT = 0.01
"""Of gravity: the stand's own force at rest lies no further from what its angles say."""
U_ATTITUDE_RAD = 1e-4
"""Standard uncertainty of the unit's axes against the stand's: how it is mounted, taken as stated."""

U_RATE = {"two_axis_turntable": 2e-5, "thermal_turntable": 5e-5, "non_magnetic_turntable": 1e-4}
"""Relative standard uncertainty of a table's rate and turn, by its kind, taken as stated."""
U_RATE_OTHERWISE = 1e-5
"""Of a three-axis table, from its encoder."""


def rate_uncertainty(recording: Recording) -> float:
    """Relative standard uncertainty of the rate of the stand that the recording names."""
    return U_RATE.get(str(recording.stand.get("kind", "")), U_RATE_OTHERWISE)


@dataclass(frozen=True)
class StandMotion:
    """Motion at n times; NaN where the stand has none.

    Attributes:
        time_s: shape (n,), of the unit's samples.
        rate_rad_s: of the body relative to the laboratory, body axes, shape (n, 3).
        dcm_body_from_ned: shape (n, 3, 3).
        latitude_rad, gravity_m_s2: of the site.
    """

    time_s: FloatArray
    rate_rad_s: FloatArray
    dcm_body_from_ned: FloatArray
    latitude_rad: float
    gravity_m_s2: float

    @property
    def earth_rate_rad_s(self) -> FloatArray:
        """In body axes, shape (n, 3)."""
        return self.dcm_body_from_ned @ earth_rate_ned(self.latitude_rad)

    @property
    def specific_force_m_s2(self) -> FloatArray:
        """Of gravity alone, in body axes, shape (n, 3)."""
        return self.dcm_body_from_ned @ np.array([0.0, 0.0, -self.gravity_m_s2])


def stand_motion(recording: Recording, time_s: FloatArray) -> StandMotion:
    """Rate and attitude at `time_s`, shape (n,).

    Raises:
        CalibrationError: no trigger joins the clocks, the stand's stream or the site lacks something, or the
            stand's angles and its own force do not agree.
    """
    refuse_unjoined(recording)
    latitude_deg, gravity = _of_site(recording, "latitude_deg"), _of_site(recording, "gravity_m_s2")
    stand = stream_with(recording, "stand", *RATES, *ANGLES)
    stand_s, rates, angles = stand.time_s(), stand.si(*RATES), stand.si(*ANGLES)
    if stand.has("acc_x", "acc_y", "acc_z"):
        still = np.flatnonzero(np.abs(rates).max(axis=1) < 1e-6)[:: max(1, len(stand) // 50)]
        told = stand.si("acc_x", "acc_y", "acc_z")[still]
        turned = _attitudes(angles[still], recording) @ np.array([0.0, 0.0, -gravity])
        if len(still) and not np.nanmax(np.abs(told - turned), initial=0.0) < MAX_DISAGREEMENT * gravity:
            raise refused(
                recording,
                "The stand's gimbal angles and its specific force at rest tell different attitudes.",
                "see how the unit is mounted, and in which axes the stand's streams are",
                "stream stand",
            )
    return StandMotion(
        time_s=time_s,
        rate_rad_s=_at(time_s, stand_s, rates),
        dcm_body_from_ned=_attitudes(_at(time_s, stand_s, angles), recording),
        latitude_rad=math.radians(latitude_deg),
        gravity_m_s2=gravity,
    )


def _of_site(recording: Recording, key: str) -> float:
    value = recording.site.get(key)
    if isinstance(value, int | float) and math.isfinite(value):
        return float(value)
    raise refused(
        recording,
        f"The recording does not state site.{key}: Earth rate and gravity in body axes are not known.",
        "write latitude_deg and gravity_m_s2 of the site into recording.json",
    )


def _at(time_s: FloatArray, stand_s: FloatArray, values: FloatArray) -> FloatArray:
    """Straight between the stand's samples, NaN in its holes and beyond its ends."""
    found: FloatArray = np.zeros((len(time_s), values.shape[1]))
    for column in range(values.shape[1]):
        found[:, column] = np.interp(time_s, stand_s, values[:, column])
    steps = np.diff(stand_s)
    period_s = float(np.median(steps)) if len(steps) else 0.0
    after = np.clip(np.searchsorted(stand_s, time_s), 1, max(len(stand_s) - 1, 1))
    in_hole = np.take(steps, after - 1, mode="clip") > HOLE_PERIODS * period_s if len(steps) else True
    beyond = (time_s < stand_s[0] - period_s) | (time_s > stand_s[-1] + period_s)
    found[(in_hole & ~np.isin(time_s, stand_s)) | beyond] = np.nan
    return found


def _attitudes(angles: FloatArray, recording: Recording) -> FloatArray:
    """Body from north, east, down: (n, 3) → (n, 3, 3)."""
    heading = math.radians(float(recording.site.get("heading_deg", 0.0)))
    sine, cosine = math.sin(heading), math.cos(heading)
    lab_from_ned = np.array([[-sine, cosine, 0.0], [cosine, sine, 0.0], [0.0, 0.0, -1.0]])
    outer, middle, inner = (_turn(axis, angle) for axis, angle in zip((2, 1, 0), angles.T, strict=True))
    return inner @ middle @ outer @ lab_from_ned


def _turn(axis: int, angle: FloatArray) -> FloatArray:
    """(n, 3, 3): coordinates in axes that are turned by the angle about one of them."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, first, first] = turn[:, second, second] = np.cos(angle)
    turn[:, first, second], turn[:, second, first] = np.sin(angle), -np.sin(angle)
    return turn
