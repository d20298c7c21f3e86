# pyright: strict
"""What a turntable sends on its encoder stream: samples without framing, since the link is TCP."""

import numpy as np

STAND_SAMPLE_DTYPE = np.dtype(
    [
        ("time_s", "<f8"),
        ("rate_rad_s", "<f8", (3,)),
        ("specific_force_m_s2", "<f8", (3,)),
        ("angles_rad", "<f8", (3,)),
        ("rates_rad_s", "<f8", (3,)),
        ("temperature_c", "<f8"),
        ("reserved", "<f8"),
    ]
)
"""One sample: body rate relative to the laboratory and specific force at the stand's centre in the unit's
nominal axes; angles and rates of outer, middle and inner axis; the table's temperature."""

STAND_SAMPLE_COLUMNS = STAND_SAMPLE_DTYPE.itemsize // 8
"""How many doubles that are."""
