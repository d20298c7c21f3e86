"""Who is at fault when a step cannot go on: the fixture's own signs are asked before a unit is blamed.

A link says that a unit does not answer; why, it cannot know. So:

    the presence contact is open               → fixture (no unit, or it does not sit)
    the supply is off, or below its setting
      without being at its current limit       → station
    the supply cannot be asked                 → station
    else                                       → the unit, a short behind a limiting supply included
"""

from protocol.errors import Fault, LinkError, TestloomError
from stations.drivers.clock import BranchClock
from stations.drivers.socket_bench import SocketBench

MIN_SHARE_OF_SETTING = 0.9


def find_fault(error: TestloomError, bench: SocketBench, clock: BranchClock) -> tuple[Fault, str]:
    """Whose fault an error is, and what the fixture said (empty if it was not asked).

    Args:
        error: what ended the step.
        bench: its socket.
        clock: the branch's clock.
    """
    if error.fault is not Fault.UNIT:
        return error.fault, ""
    try:
        board = bench.board(clock)
        if board is not None and not board.unit_present():
            return Fault.FIXTURE, "The presence contact is open."
        return _supply_fault(bench, clock)
    except LinkError as unreachable:
        return Fault.STATION, f"The fixture cannot be asked: {unreachable.what}"


def _supply_fault(bench: SocketBench, clock: BranchClock) -> tuple[Fault, str]:
    supply = bench.supply(clock)
    wanted_v = supply.set_voltage_v
    if wanted_v is None:
        return Fault.UNIT, "The unit sits in the socket, unpowered."
    if not supply.is_on():
        return Fault.STATION, "The supply's output is off although it was switched on."
    voltage_v = supply.measure_voltage_v()
    if voltage_v >= MIN_SHARE_OF_SETTING * wanted_v:
        return Fault.UNIT, f"The unit sits in the socket and is supplied with {voltage_v:.2f} V."
    if supply.limits_current():
        return Fault.UNIT, f"The unit pulls the supply down to {voltage_v:.2f} V at its current limit."
    return Fault.STATION, f"The supply gives {voltage_v:.2f} V instead of {wanted_v:.2f} V."
