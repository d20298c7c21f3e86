"""Gravity at the place of a recording: what the recording says, or the standard value with its doubt."""

import math
from dataclasses import dataclass

from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

UNKNOWN_SITE_GRAVITY_M_S2 = 0.015
"""Standard uncertainty at an unknown place: 9.780 (equator) to 9.832 m/s^2 (poles), rectangular."""


@dataclass(frozen=True)
class Gravity:
    """Magnitude, standard uncertainty, and the sentence for people that says where it is from."""

    magnitude_m_s2: float
    standard_uncertainty_m_s2: float
    sentence: str

    @property
    def relative_uncertainty(self) -> float:
        """Standard uncertainty over magnitude."""
        return self.standard_uncertainty_m_s2 / self.magnitude_m_s2


def gravity(recording: Recording) -> Gravity:
    """Magnitude of gravity for a recording, from its site or as the standard value, and said."""
    stated = recording.site.get("gravity_m_s2")
    if isinstance(stated, int | float) and math.isfinite(stated) and stated > 0:
        sentence = say("gravity {gravity} m/s² as the recording's site says", gravity=f"{stated:.5f}")
        return Gravity(float(stated), 0.0, sentence)
    sentence = say(
        "gravity {gravity} m/s², standard, ± {uncertainty} m/s²: the recording does not say its site",
        gravity=f"{STANDARD_GRAVITY_M_S2:.5f}",
        uncertainty=f"{UNKNOWN_SITE_GRAVITY_M_S2:.3f}",
    )
    return Gravity(STANDARD_GRAVITY_M_S2, UNKNOWN_SITE_GRAVITY_M_S2, sentence)
