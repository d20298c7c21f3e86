# pyright: strict
"""What a streaming unit says on CAN: compensated rate and specific force, by the DBC's layout.

Every 10 ms, or with every sample where these come slower. Like the stream's samples they leave in blocks.
The DBC is read by the station's side; here its bytes are made at once for a whole block. A test holds the two
against each other.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.interfaces import LinkOutput
from dut_emulator.products.gnc_module.inertial_sensors import SensorSamples
from dut_emulator.products.gnc_module.stream import SampleStream
from dut_emulator.products.gnc_module.unit_twin import ACC_LSB_M_S2, GYRO_LSB_RAD_S

RATE_ID, SPECIFIC_FORCE_ID = 0x110, 0x111
RATE_BIT_RAD_S, FORCE_BIT_M_S2 = 2.0**-12, 2.0**-6
PERIOD_S = 0.010
_LARGEST = 2**15 - 1


def can_frames(samples: SensorSamples, stream: SampleStream, latest_s: float) -> list[LinkOutput]:
    """The frames of a stream's next samples, compensated; they leave with their block, or at the latest."""
    every, first = max(1, round(PERIOD_S * stream.rate_hz)), stream.taken
    chosen = np.arange(-first % every, len(samples.gyro), every)
    rates = _words(samples.gyro[chosen] * (GYRO_LSB_RAD_S / RATE_BIT_RAD_S), first + chosen)
    forces = _words(samples.acc[chosen] * (ACC_LSB_M_S2 / FORCE_BIT_M_S2), first + chosen)
    block = stream.samples_per_block
    ends = ((first + chosen) // block + 1) * block
    times_s = np.minimum(stream.started_s + ends * stream.period_s, latest_s).tolist()
    return [
        LinkOutput(time_s, "can", data, identifier)
        for time_s, rate, force in zip(times_s, rates, forces, strict=True)
        for identifier, data in ((RATE_ID, rate), (SPECIFIC_FORCE_ID, force))
    ]


def _words(values: NDArray[np.floating[Any]], counters: NDArray[np.int64]) -> list[bytes]:
    rows = np.empty((len(values), 4), dtype="<i2")
    rows[:, :3] = np.clip(np.rint(values), -_LARGEST, _LARGEST)
    rows[:, 3] = counters.astype(np.uint16).view(np.int16)
    whole = rows.tobytes()
    return [whole[at : at + 8] for at in range(0, len(whole), 8)]
