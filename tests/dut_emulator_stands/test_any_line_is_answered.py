"""Whatever a client writes to a stand's command port, in whatever state, is answered by one line."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.stands.catalogue import STANDS, live_stand
from dut_emulator.stands.command_port import CommandPort
from protocol.bench_description import Site

SITE = Site(latitude_deg=40.0, gravity_m_s2=9.8)
NAMES = ["outer", "middle", "inner", "satellite_static", "satellite_trajectory", "vehicle_run", "flight"]
SMALL = ["0", "-0", "1", "-1", "2", "3", "5", "-3", "0.5", "400", "-90", "90", "1_0"]
EXTREME = ["1e-9", "1e-300", "1e9", "-1e9", "1e300", "-1e300", "1e400", "nan", "inf", "x", "", "="]
NAMED = ["ON", "speed_m_s=1e9", "duration_s=-1"]
ARGUMENTS = st.lists(
    st.sampled_from([*NAMES, *SMALL, *EXTREME, *NAMED]) | st.text("!?*;:/\\'\"Az19", max_size=3), max_size=4
)


@pytest.mark.parametrize("kind", sorted(STANDS))
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_line_is_answered(kind: str, data: st.DataObject) -> None:
    port = live_stand(kind, 1, SITE, "S-1").port
    assert isinstance(port, CommandPort)
    words = [*port.COMMANDS, "STRE", "CAL?", "FLY", ""]
    now_s = 0.0
    if "HOME" in port.COMMANDS:
        port.command("HOME", now_s)
        now_s = 100.0
    for _ in range(8):
        match data.draw(st.sampled_from(["line", "line", "line", "line", "fault", "time"])):
            case "fault":
                port.inject(data.draw(st.sampled_from(port.FAULTS)), now_s)
            case "time":
                now_s += data.draw(st.sampled_from([0.001, 0.1, 5.0, 60.0]))
                port.advance(now_s)
            case _:
                line = f"{data.draw(st.sampled_from(words))} {','.join(data.draw(ARGUMENTS))}"
                answer = port.command(line, now_s)
                assert answer
                assert answer.isprintable(), line


@pytest.mark.parametrize(
    ("kind", "line"), [("sinusoidal_overload_rig", "RUN -3"), ("two_axis_turntable", "SWING inner,1,1e300,3")]
)
def test_numbers_that_no_stand_can_take_are_refused(kind: str, line: str) -> None:
    port = live_stand(kind, 1, SITE, "S-1").port
    port.command("HOME", 0.0)
    assert port.command(line, 100.0).startswith("ERR ")
