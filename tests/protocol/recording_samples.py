"""Recordings for the tests of their forms: one by hand, and any that hypothesis thinks of."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from protocol.recording_checks import SAMPLE_TYPES
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import KNOWN_UNITS

DUT_UNITS = {
    "t": "s",
    "gyro_x": "deg/s",
    "gyroX": "rad/s",
    "counter": "1",
    "valid": "1",
    "temp, inner": "degC",
}


def sample_recording(samples: int = 50) -> Recording:
    """Two streams with several types, a missing value, odd column names and keys beyond the format."""
    rng = np.random.default_rng(4)
    time = np.arange(samples) / 200
    gyro = rng.normal(size=samples)
    gyro[3 % samples :: 7] = np.nan
    dut = {
        "t": time,
        "gyro_x": gyro,
        "gyroX": rng.normal(size=samples).astype(np.float32),
        "counter": (np.arange(samples) + 250).astype(np.uint8),
        "valid": np.arange(samples) % 3 == 0,
        "temp, inner": np.full(samples, -0.25),
    }
    stand = {"time_us": np.arange(samples // 2, dtype=np.int64) * 10_000, "rate_x": np.zeros(samples // 2)}
    return Recording(
        recording_id="sample-1",
        unit={"serial": "U-1", "product": "gnc_module"},
        test={"profile": "rate_staircase", "run": 1, "started_at": "2026-01-01T00:00:00Z"},
        site={"latitude_deg": 34.2},
        believed={"gyro": {"bias": [0.0, 1.5, -2.0], "bandwidth_hz": None}},
        extra={"operator's note": "温度稳定"},
        streams={
            "dut": Stream("dut", "unit clock", "t", DUT_UNITS, dut, extra={"filter": [1, 2]}),
            "stand": Stream("stand", "stand", "time_us", {"time_us": "us", "rate_x": "deg/s"}, stand),
        },
    )


def _samples(kind: str, count: int) -> st.SearchStrategy[np.ndarray]:
    if kind == "bool":
        elements: st.SearchStrategy = st.booleans()
    elif kind.startswith("float"):
        width = 32 if kind == "float32" else 64
        # one NaN is like another: their bits are not part of what a recording says
        elements = st.floats(width=width, allow_infinity=False, allow_nan=False) | st.just(float("nan"))
    else:
        info = np.iinfo(kind)
        elements = st.integers(int(info.min), int(info.max))
    return hnp.arrays(np.dtype(kind), count, elements=elements)


@st.composite
def streams(draw: st.DrawFn, name: str) -> Stream:
    """A stream with any columns of any type."""
    count = draw(st.integers(0, 12))
    names = draw(
        st.lists(
            st.text("abX_1 .,é\"'", min_size=1, max_size=4).filter(
                lambda text: text.strip() == text and text != "t"
            ),
            unique=True,
            max_size=5,
        )
    )
    units = {"t": draw(st.sampled_from(["s", "ms", "us"]))}
    columns = {"t": np.sort(draw(hnp.arrays(np.float64, count, elements=st.floats(-1e6, 1e6))))}
    for column in names:
        units[column] = draw(st.sampled_from(KNOWN_UNITS))
        columns[column] = draw(_samples(draw(st.sampled_from(sorted(SAMPLE_TYPES))), count))
    return Stream(name, "clock", "t", units, columns)


_JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**40), 2**40)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
_OBJECTS = st.dictionaries(st.text(max_size=5), _JSON, max_size=3)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """A sound recording."""
    names = draw(
        st.lists(st.sampled_from(["dut", "stand", "a-1", "B.c"]), min_size=1, max_size=2, unique=True)
    )
    return Recording(
        recording_id=draw(st.text(min_size=1, max_size=8)),
        unit=draw(_OBJECTS),
        test=draw(_OBJECTS),
        stand=draw(_OBJECTS),
        believed=draw(_OBJECTS),
        streams={name: draw(streams(name)) for name in names},
    )
