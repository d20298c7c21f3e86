"""What a recording says of its sensors beforehand: range, bias instability, names of channels."""

import math
from collections.abc import Mapping
from typing import Any

from calibration.imu_session import SlowNoise
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

RANGE_MARGIN = 0.002
"""Full-scale words end up to this part inside the nominal range (32767 / 16.4 = 1998 of 2000 deg/s)."""


def sensor_range(recording: Recording, kind: str) -> float | None:
    """End of the range of 'gyro' or 'acc' in SI, a margin inside the nominal one; None: not known."""
    described = recording.believed.get(kind)
    if not isinstance(described, Mapping) or not isinstance(described.get("range"), int | float):
        return None
    unit = str(described.get("unit", ""))
    return float(described["range"]) * factor_to_si(unit) * (1.0 - RANGE_MARGIN)


def slow_noise(recording: Recording, kind: str) -> tuple[SlowNoise, ...]:
    """What the recording states of the slow noise of 'gyro' or 'acc'; empty: nothing.

    `bias_instability` counts where it has a correlation time. `turn_on_repeatability` (value, unit and
    unit_spread) is the standard deviation of the bias from one power-on to the next.
    """
    described = recording.believed.get(kind)
    if not isinstance(described, Mapping):
        return ()
    terms: list[SlowNoise] = []
    instability, turn_on = described.get("bias_instability"), described.get("turn_on_repeatability")
    if isinstance(instability, Mapping) and isinstance(instability.get("correlation_time_s"), int | float):
        terms.append(SlowNoise(_level_si(instability), float(instability["correlation_time_s"])))
    if isinstance(turn_on, Mapping):
        terms.append(SlowNoise(_level_si(turn_on), math.inf))
    return tuple(terms)


def _level_si(stated: Mapping[str, Any]) -> float:
    """Root mean square of a level that is log-normal over units: its median times exp(spread^2)."""
    spread = stated.get("unit_spread", 0.0)
    rms = math.exp(float(spread) ** 2) if isinstance(spread, int | float) else 1.0
    return float(stated["value"]) * rms * factor_to_si(str(stated["unit"]))


def axes(kind: str) -> tuple[str, str, str]:
    """Names of the three channels of 'gyro' or 'acc'."""
    return f"{kind}_x", f"{kind}_y", f"{kind}_z"
