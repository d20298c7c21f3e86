# pyright: strict
"""What acts on a unit on a turntable, from the table's pose: Earth rate and the table's, gravity, field.

The true rate is inertial: the Earth's is in it. What the stand reports is relative to the laboratory, so the
Earth's is not in that, and 'stand.earth_rate' of the catalogue is what a simulator lacks that is driven by
such a report; it is never one of a stand's own errors here.
"""

import math
from dataclasses import dataclass

import numpy as np

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.effect import FloatArray, Stimulus
from protocol.bench_description import Site


@dataclass(frozen=True)
class Report:
    """What a stand says, (n, 3) each, in the unit's nominal axes; rates relative to the laboratory."""

    rate_rad_s: FloatArray
    specific_force_m_s2: FloatArray
    field_t: FloatArray
    angles_rad: FloatArray


class Laboratory:
    """The Earth at a site. Poses are gimbal angles (n, 3): outer, middle, inner."""

    def __init__(self, site: Site) -> None:
        self._gravity_m_s2 = site.gravity_m_s2
        self._earth_rate = geometry.earth_rate_lab_rad_s(site)
        self._field = geometry.field_lab_t(site)

    def acting(
        self, times_s: FloatArray, angles_rad: FloatArray, rates_rad_s: FloatArray, temperature_c: FloatArray
    ) -> Stimulus:
        """What truly acts at the stand's centre; `sample_period_s` is left open."""
        attitude = geometry.Attitude(angles_rad)
        earth_rate = attitude.into_body(self._earth_rate)
        rate = attitude.body_rate(rates_rad_s)
        rate += earth_rate
        return Stimulus(
            time_s=times_s,
            temperature_c=temperature_c,
            sample_period_s=math.nan,
            rate_rad_s=rate,
            specific_force_m_s2=attitude.up(self._gravity_m_s2),
            field_t=attitude.into_body(self._field),
            angles_rad=angles_rad,
            earth_rate_rad_s=earth_rate,
        )

    def reported(self, angles_rad: FloatArray, rates_rad_s: FloatArray) -> Report:
        """What follows from the encoders."""
        attitude = geometry.Attitude(angles_rad)
        return Report(
            rate_rad_s=attitude.body_rate(rates_rad_s),
            specific_force_m_s2=attitude.up(self._gravity_m_s2),
            field_t=attitude.into_body(self._field),
            angles_rad=angles_rad,
        )


def rounded(values: FloatArray, quantum: float) -> FloatArray:
    """To whole quanta of an encoder."""
    whole = np.rint(values / quantum)
    whole *= quantum
    return whole
