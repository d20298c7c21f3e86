"""How a next test is made: ordered on a line where a plan does it, or recorded on a bench."""

from collections.abc import Iterator

from gap_diagnosis.report_document import NextTestEntry, ReportDocument
from protocol.language import say
from protocol.routes import ROUTES

STEPS_OF_PROFILES = {"multi_position": "imu_six_positions", "rotation": "imu_turns"}
"""Profile → the step of a plan that does the same motion."""


def ways_to_test(report: ReportDocument, test: NextTestEntry) -> Iterator[str]:
    """Lines for a person: commands, or why there is none."""
    serials = list(dict.fromkeys(one.serial for one in report.recordings if one.serial))
    plan = None if test.values else _plan_with(report.product, test.profile)
    if plan is None:
        yield say("No plan of a line does this test yet: a bench has to record it.")
    else:
        route, stand, name = plan
        yield say("On a line, by the plan '{plan}' ({stand}):", plan=name, stand=stand)
        yield f"  testloom order --route {route} --serials {','.join(serials) or 'SERIAL'}"
    if report.product:
        settings = "".join(f" --set {key}={value:g}" for key, value in test.values.items())
        serial = f" --serial {serials[0]}" if serials else ""
        yield say("On an emulated unit:")
        yield f"  testloom emulator record {report.product} {test.profile}{settings}{serial} --out runs"


def _plan_with(product: str, profile: str) -> tuple[str, str, str] | None:
    """(route, kind of stand, plan) that moves a unit of this product like this profile."""
    from dut_emulator.products.catalogue import PRODUCTS, product_named
    from stations.sequencing.step_registry import bundled_plans

    step = STEPS_OF_PROFILES.get(profile)
    if step is None or product not in PRODUCTS:
        return None
    for plan in bundled_plans().values():
        for route in ROUTES.values():
            operations = {operation.name for operation in route.operations}
            does_it = step in {one.step for one in plan.steps()} and plan.operation in operations
            if does_it and plan.product == route.product == product:
                return route.name, product_named(product).profiles[profile].stand, plan.name
    return None
