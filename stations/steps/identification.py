"""Boot, and who it is that answers."""

from protocol.errors import Fault, TestloomError
from protocol.gnc_module import BOOT_DURATION_S
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step
from stations.steps.power import POWERED_ON_S


@step("boot_and_identify", ["boot_duration", "firmware_version", "hardware_revision"])
def boot_and_identify(context: StepContext) -> None:
    """Wait for the unit's first answer, and compare its serial with the lease's.

    Parameter answer_within_s: after power-on.

    Raises:
        LinkError: the unit does not answer in time.
        TestloomError: another unit answers; nothing may be measured on it under this lease.
    """
    powered_on_s = context.values.get(POWERED_ON_S)
    since_s = powered_on_s if isinstance(powered_on_s, float) else context.clock.now_s()
    context.clock.sleep_until(since_s + BOOT_DURATION_S)
    within_s = context.number("answer_within_s")
    if not context.unit.answers_within(since_s + within_s):
        raise context.unit.no_answer(f"IDENTIFY within {within_s:g} s of power-on")
    if context.declares("boot_duration"):
        context.measure("boot_duration", context.clock.now_s() - since_s)
    said = context.unit.identify()
    if said.serial != context.lease.unit.serial:
        raise TestloomError(
            f"Another unit is in this socket: it says {said.serial}, "
            f"the lease is for {context.lease.unit.serial}.",
            where=f"socket {context.lease.socket}",
            fault=Fault.OPERATOR,
            remedy="put the right unit in, or order this one.",
        )
    for name, value in (
        ("firmware_version", said.firmware_version),
        ("hardware_revision", said.hardware_revision),
    ):
        if context.declares(name):
            context.measure(name, value)
