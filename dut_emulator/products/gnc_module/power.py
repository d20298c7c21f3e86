# pyright: strict
"""States of the unit's power and the processor.

A unit is OFF until its supply passes the turn-on voltage. It then boots for a fixed time, during which it
hears nothing and only its heartbeat (on CAN) shows that it lives; after that it is READY: it answers, runs
self-tests side by side (one on each resource) and streams. A brown-out takes it back to OFF from anywhere
and with it all that RAM held: running tests, the stream, counters. Flash stays. A reset by command boots
again without loss of power: RAM is lost, the clock since power-on and the sensors' warmth are not.

What the transitions do not say: READY's concurrent self-tests are no states of the unit. Each resource
is idle or runs one test, independently of the others (`Firmware`).
"""

from enum import StrEnum

from protocol.errors import Fault, TestloomError


class PowerState(StrEnum):
    """Where the unit is."""

    OFF = "OFF"
    BOOT = "BOOT"
    READY = "READY"


class PowerEvent(StrEnum):
    """What happens to it."""

    SUPPLY_GOOD = "SUPPLY_GOOD"
    SUPPLY_LOST = "SUPPLY_LOST"
    BOOTED = "BOOTED"
    RESET = "RESET"


TRANSITIONS: dict[tuple[PowerState, PowerEvent], PowerState] = {
    (PowerState.OFF, PowerEvent.SUPPLY_GOOD): PowerState.BOOT,
    (PowerState.BOOT, PowerEvent.BOOTED): PowerState.READY,
    (PowerState.BOOT, PowerEvent.SUPPLY_LOST): PowerState.OFF,
    (PowerState.READY, PowerEvent.SUPPLY_LOST): PowerState.OFF,
    (PowerState.READY, PowerEvent.RESET): PowerState.BOOT,
}


def next_state(state: PowerState, event: PowerEvent) -> PowerState:
    """The state after an event.

    Raises:
        TestloomError: the event cannot happen in this state.
    """
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise TestloomError(
            f"The event {event} cannot happen in the state {state}.",
            where="emulated unit, power",
            fault=Fault.TESTLOOM,
            remedy="report this: the emulator's shell sent events out of order.",
        ) from None
