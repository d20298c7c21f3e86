"""Power: on, the rails at their test points, the current, off."""

from protocol.gnc_module import BOOT_DURATION_S, GROUND_TEST_POINT, RIPPLE_TEST_POINT
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step

RAIL_TEST_POINTS = {"supply_voltage": "5V_1", "rail_3v3": "3V3_1", "rail_1v2": "1V2_1"}
POWERED_ON_S = "powered_on_s"
"""Value carried on: the bench time of power-on."""


@step("power_up")
def power_up(context: StepContext) -> None:
    """Set and switch the supply. Parameters: voltage_v, current_limit_a, settling_s."""
    context.power.configure(context.number("voltage_v"), context.number("current_limit_a"))
    context.power.switch(True)
    context.values[POWERED_ON_S] = context.clock.now_s()
    context.clock.sleep_until(context.clock.now_s() + context.number("settling_s"))


@step("measure_rails", [*RAIL_TEST_POINTS, "ripple_5v"])
def measure_rails(context: StepContext) -> None:
    """Rails with the multimeter, ripple with the oscilloscope, at the unit's own pins."""
    board = context.needed_board()
    with context.multimeter() as multimeter:
        for name, point in RAIL_TEST_POINTS.items():
            if context.declares(name):
                board.route(point, GROUND_TEST_POINT)
                context.measure(name, multimeter.measure_voltage_v())
    if context.declares("ripple_5v"):
        with context.oscilloscope() as oscilloscope:
            board.route(RIPPLE_TEST_POINT, GROUND_TEST_POINT)
            context.measure("ripple_5v", oscilloscope.measure_peak_to_peak_v())


@step("measure_supply", ["supply_current", "supply_output_voltage"])
def measure_supply(context: StepContext) -> None:
    """The supply's own readings, once the unit has booted and draws its steady current."""
    powered_on_s = context.values.get(POWERED_ON_S)
    if isinstance(powered_on_s, float):
        context.clock.sleep_until(powered_on_s + BOOT_DURATION_S)
    if context.declares("supply_output_voltage"):
        context.measure("supply_output_voltage", context.power.measure_voltage_v())
    if context.declares("supply_current"):
        context.measure("supply_current", context.power.measure_current_a())


@step("power_down")
def power_down(context: StepContext) -> None:
    """Switch the supply off."""
    context.power.switch(False)
