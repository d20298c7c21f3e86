# pyright: strict
"""Long records that move fast hold more rows than a diagnosis needs: a part of each minute is enough.

What acted is kept whole, so that effects with a memory know it; only the rows that are compared are fewer.
The part begins at another place in each minute, by the golden ratio (Weyl's sequence): spread evenly over the
minute, and a motion that repeats itself every minute, or every few, is still seen in all its phases.
"""

import dataclasses
import math

import numpy as np

from gap_diagnosis.observation import Observation, SetAside

MAX_ROWS = 60_000
"""Rows of a recording that are compared: some 200 columns of six channels stay below a gigabyte."""
WINDOW_S = 60.0
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def with_enough_rows(observation: Observation, most: int = MAX_ROWS) -> Observation:
    """The observation with a part of every minute usable, where it has more than `most` rows."""
    rows = int(np.count_nonzero(observation.usable))
    if rows <= most:
        return observation
    time_s = observation.stimulus.time_s
    share = most / rows
    window, into_window_s = np.divmod(time_s - time_s[0], WINDOW_S)
    begins_s = (window * GOLDEN % 1.0) * (1.0 - share) * WINDOW_S
    usable = observation.usable & (into_window_s >= begins_s)
    usable &= into_window_s < begins_s + share * WINDOW_S
    left_out = rows - int(np.count_nonzero(usable))
    note = SetAside(
        "rows of a long record",
        left_out,
        f"of each minute {share * WINDOW_S:.0f} s are enough",
    )
    return dataclasses.replace(observation, usable=usable, set_aside=(*observation.set_aside, note))
