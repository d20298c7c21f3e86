"""Yield kept incrementally against yield counted from scratch, in both conventions."""

from collections import defaultdict

from hypothesis import given
from hypothesis import strategies as st

from coordinator.core.yield_statistics import Tally, YieldStatistics, final_yield
from protocol.outcomes import Disposition

JUDGEMENTS = st.sampled_from(["passed", "failed", "disturbed"])
ATTEMPTS = st.lists(
    st.tuples(
        st.integers(0, 4),
        st.sampled_from(["functional", "imu_calibration"]),
        st.sampled_from(["S1", "S2", "S3"]),
        JUDGEMENTS,
    ),
    max_size=60,
)


@given(ATTEMPTS)
def test_incremental_equals_recomputed(attempts) -> None:
    statistics = YieldStatistics()
    history: dict[tuple[int, str], list[tuple[str, str]]] = defaultdict(list)
    for unit, operation, station, judgement in attempts:
        earlier = history[unit, operation]
        judged_before = any(kind != "disturbed" for _, kind in earlier)
        statistics.add(operation, station, judgement, not earlier, judged_before)
        earlier.append((station, judgement))

    # An independent count, from whole histories instead of step by step.
    def counted(operation: str, station: str | None) -> Tally:
        mine = [steps for (_, op), steps in history.items() if op == operation]
        here = [kind for steps in mine for where, kind in steps if station in (None, where)]
        firsts = [steps[0] for steps in mine if steps and station in (None, steps[0][0])]
        judged = [next((s for s in steps if s[1] != "disturbed"), None) for steps in mine]
        judged_here = [s for s in judged if s is not None and station in (None, s[0])]
        return Tally(
            first_attempts=len(firsts),
            first_passes=sum(kind == "passed" for _, kind in firsts),
            first_judged=len(judged_here),
            first_unit_faults=sum(kind == "failed" for _, kind in judged_here),
            attempts=len(here),
            passes=sum(kind == "passed" for kind in here),
        )

    for operation, tally in statistics.operations.items():
        assert tally == counted(operation, None)
    for (operation, station), tally in statistics.stations.items():
        assert tally == counted(operation, station)


def test_the_two_conventions_differ_by_the_stations_faults() -> None:
    statistics = YieldStatistics()
    # Ten units: seven pass at once, one fails, two lose their first attempt to the station and pass.
    for _ in range(7):
        statistics.add("functional", "S1", "passed", True, False)
    statistics.add("functional", "S1", "failed", True, False)
    for _ in range(2):
        statistics.add("functional", "S1", "disturbed", True, False)
        statistics.add("functional", "S2", "passed", False, False)
    tally = statistics.operations["functional"]
    assert (tally.fpy, tally.fpy_unit) == (0.7, 0.9)
    for _ in range(4):
        statistics.add("imu_calibration", "T1", "passed", True, False)
    statistics.add("imu_calibration", "T1", "failed", True, False)
    rty, rty_unit = statistics.rolled(["functional", "imu_calibration"])
    assert rty is not None
    assert rty_unit is not None
    assert abs(rty - 0.56) < 1e-12
    assert abs(rty_unit - 0.72) < 1e-12
    assert statistics.rolled(["functional", "never_run"]) == (None, None)
    assert final_yield({Disposition.SHIP: 9, Disposition.SCRAP: 1}) == 0.9
    assert final_yield({}) is None
