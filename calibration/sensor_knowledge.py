"""What a recording says of its sensors beforehand: range, bias instability, names of channels."""

import math
from collections.abc import Mapping

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


def slow_noise(recording: Recording, kind: str) -> SlowNoise | None:
    """Bias instability that the recording states with its correlation time; None otherwise."""
    described = recording.believed.get(kind)
    stated = described.get("bias_instability") if isinstance(described, Mapping) else None
    if not isinstance(stated, Mapping) or not isinstance(stated.get("correlation_time_s"), int | float):
        return None
    spread = stated.get("unit_spread", 0.0)
    # The level is log-normal over units: its root mean square is the median times exp(spread^2).
    rms = math.exp(float(spread) ** 2) if isinstance(spread, int | float) else 1.0
    level = float(stated["value"]) * rms * factor_to_si(str(stated["unit"]))
    return SlowNoise(level, float(stated["correlation_time_s"]))


def axes(kind: str) -> tuple[str, str, str]:
    """Names of the three channels of 'gyro' or 'acc'."""
    return f"{kind}_x", f"{kind}_y", f"{kind}_z"
