# pyright: strict
"""What a streaming unit says on CAN: compensated rate and specific force, by the DBC's layout.

Every 10 ms, or with every sample where these come slower. Like the stream's samples they leave in blocks, one
burst each.
The DBC is read by the station's side; here its bytes are made at once for a whole block. A test holds the two
against each other.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.interfaces import LinkOutput
from dut_emulator.products.gnc_module.flash import Coefficients
from dut_emulator.products.gnc_module.inertial_sensors import SensorSamples
from dut_emulator.products.gnc_module.stream import SampleStream
from dut_emulator.products.gnc_module.unit_twin import ACC_LSB_M_S2, GYRO_LSB_RAD_S
from protocol.gnc_module import Sensor

BURST_IDS = (0x110, 0x111)
"""Rate, specific force."""
RATE_BIT_RAD_S, FORCE_BIT_M_S2 = 2.0**-12, 2.0**-6
PERIOD_S = 0.010
_LARGEST = 2**15 - 1


def can_bursts(
    raw: SensorSamples, coefficients: Mapping[Sensor, Coefficients], stream: SampleStream, latest_s: float
) -> list[LinkOutput]:
    """A stream's next samples as frames, compensated: a burst leaves with each block, or at the latest."""
    every, first = max(1, round(PERIOD_S * stream.rate_hz)), stream.taken
    chosen = slice(-first % every, None, every)
    samples = raw.at(chosen).compensated(coefficients[Sensor.GYRO], coefficients[Sensor.ACC])
    counters = np.arange(first, first + len(raw.gyro))[chosen]
    words = np.empty((len(counters), len(BURST_IDS), 4), dtype="<i2")
    words[:, 0, :3] = _clipped(samples.gyro * (GYRO_LSB_RAD_S / RATE_BIT_RAD_S))
    words[:, 1, :3] = _clipped(samples.acc * (ACC_LSB_M_S2 / FORCE_BIT_M_S2))
    words[:, :, 3] = counters.astype(np.uint16).view(np.int16)[:, np.newaxis]
    blocks = counters // stream.samples_per_block
    begins = np.flatnonzero(np.diff(blocks, prepend=-1))
    ends_s = stream.started_s + (blocks[begins] + 1) * stream.samples_per_block * stream.period_s
    data, cuts = words.tobytes(), [*(begins * words[:1].nbytes).tolist(), words.nbytes]
    return [
        LinkOutput(time_s, "can", data[cut:end], burst_ids=BURST_IDS)
        for time_s, cut, end in zip(np.minimum(ends_s, latest_s).tolist(), cuts, cuts[1:], strict=False)
    ]


def _clipped(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    return np.clip(np.rint(values), -_LARGEST, _LARGEST)
