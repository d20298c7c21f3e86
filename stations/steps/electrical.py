"""Static tests on the unpowered unit (paper 1, section 2): every pair of test points of the product.

One step measures one kind of pair with the shared multimeter, holding it for all of them: relays
settle 5 ms, the aperture is one power-line cycle, so that a pair takes 25 ms. An open circuit reads
9.9E+37 ohm: a FAIL of a continuity, a PASS of an insulation.
"""

from collections.abc import Sequence

from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS, PinPair
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step


@step("measure_continuity", [f"continuity_{pair.name}" for pair in CONTINUITY_PAIRS])
def measure_continuity(context: StepContext) -> None:
    """Pins that belong together are connected."""
    _measure_pairs(context, "continuity", CONTINUITY_PAIRS)


@step("measure_insulation", [f"insulation_{pair.name}" for pair in INSULATION_PAIRS])
def measure_insulation(context: StepContext) -> None:
    """Pins that do not belong together are not."""
    _measure_pairs(context, "insulation", INSULATION_PAIRS)


@step("measure_impedance", [f"impedance_{pair.name}" for pair in IMPEDANCE_PAIRS])
def measure_impedance(context: StepContext) -> None:
    """Rails to ground: a short shows here, before it can burn."""
    _measure_pairs(context, "impedance", IMPEDANCE_PAIRS)


def _measure_pairs(context: StepContext, kind: str, pairs: Sequence[PinPair]) -> None:
    board = context.needed_board()
    with context.multimeter() as multimeter:
        for pair in pairs:
            name = f"{kind}_{pair.name}"
            if context.declares(name):
                board.route(pair.high, pair.low)
                context.measure(name, multimeter.measure_resistance_ohm())
