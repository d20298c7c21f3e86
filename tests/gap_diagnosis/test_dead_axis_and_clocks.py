"""A dead axis does not move a clock: the axes that live say when the motion was."""

import numpy as np

from gap_diagnosis.alignment import coarse_alignment
from gap_diagnosis.unit_outputs import UnitTriad
from protocol.recordings import Recording, Stream

DEG = np.pi / 180.0


def steps_about_each_axis() -> tuple[np.ndarray, np.ndarray]:
    """The same staircase about x and z, another about y: the norm of x fits to z's as well."""
    time_s = np.arange(0.0, 165.0, 0.01)
    up, down = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 4], [9, 1, 7, 0, 8, 2, 6, 3, 5, 4, 1]
    rates = np.zeros((len(time_s), 3))
    for axis in range(3):
        inside = (time_s >= 55.0 * axis) & (time_s < 55.0 * (axis + 1))
        stairs = 30.0 * np.array(down if axis == 1 else up)
        rates[inside, axis] = stairs[((time_s[inside] - 55.0 * axis) / 5.0).astype(int)]
    return time_s, rates


def test_a_dead_axis_moves_no_clock() -> None:
    time_s, rates = steps_about_each_axis()
    seen = rates + 0.05 * np.random.default_rng(1).standard_normal(rates.shape)
    seen[:, 2] = 0.0
    columns = {f"rate_{axis}": rates[:, i] for i, axis in enumerate("xyz")}
    units = {"t": "s", **dict.fromkeys(columns, "deg/s")}
    stand = Stream("stand", "stand", "t", units, {"t": time_s, **columns})
    recording = Recording("r", {}, {}, {"stand": stand})
    found = coarse_alignment(recording, time_s, {"gyro": UnitTriad(seen * DEG)})
    assert found.added_s is None
    assert abs(found.about_s) < 0.02
