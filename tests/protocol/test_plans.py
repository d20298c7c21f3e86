"""A plan is checked whole before a unit is touched, and its hash is that of its content."""

import pytest
import yaml

from protocol.errors import Fault, PlanError
from protocol.plans import Parallel, parse_plan

KNOWN = {"rails": frozenset({"rail_5v", "rail_ok"}), "can": frozenset({"echoes"}), "power_off": frozenset()}

PLAN = """
format: testloom-plan/1
name: functional
version: 1.2.3
product: gnc_module
operation: functional
deadline_s: 60
sequence:
  main:
    - step: rails
      timeout_s: 1e1   # a number, also to PyYAML
      gate: true
      parameters: {settle_s: 0.5, channels: [1, 2]}
      measurements:
        - {name: rail_5v, unit: V, low: 4.75, high: 5.25, standard_uncertainty: 0.01}
        - {name: rail_ok, equals: true}
    - parallel:
        - - {step: can, timeout_s: 5, measurements: [{name: echoes, low: 8}]}
        - - {step: can, timeout_s: 5}
  teardown:
    - {step: power_off, timeout_s: 2}
"""


def plan_of(text: str):
    return parse_plan(text, where="plans/functional.yaml", known_steps=KNOWN)


def test_a_plan_is_read_as_written():
    plan = plan_of(PLAN)
    assert [step.step for step in plan.steps()] == ["rails", "can", "can", "power_off"]
    rails, side_by_side = plan.sequence.main
    assert isinstance(side_by_side, Parallel)
    assert not isinstance(rails, Parallel)
    assert rails.timeout_s == 10
    assert rails.parameters == {"settle_s": 0.5, "channels": (1, 2)}
    assert plan.reference().sha256 == plan.sha256()


def test_the_hash_is_that_of_the_content():
    plan = plan_of(PLAN)
    rewritten = yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=True, default_flow_style=True)
    assert rewritten != PLAN
    assert plan_of(rewritten).sha256() == plan.sha256()
    assert plan_of(PLAN.replace("4.75", "4.750")).sha256() == plan.sha256()
    for before, after in (("4.75", "4.7500001"), ("1.2.3", "1.2.4"), ("gate: true", "gate: false")):
        assert plan_of(PLAN.replace(before, after)).sha256() != plan.sha256()


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("low: 4.75", "low: 6", "rail_5v: the limits are crossed"),
        ("unit: V", "unit: volt", "unit 'volt' is not known"),
        ("step: rails", "step: fails", "step 'fails' that this station does not know"),
        ("name: rail_ok", "name: rail_3v", "does not take a measurement 'rail_3v'"),
        ("name: rail_ok", "name: rail_5v", "rail_5v is declared twice"),
        ("equals: true", "equals: true, low: 1", "limits or 'equals', not both"),
        ("low: 4.75", "low: .nan", "finite number"),
        ("equals: true", "equals: .inf", "finite number"),
        ("settle_s: 0.5", "settle_s: .nan", "finite number"),
        ("timeout_s: 2", "timeout_s: 0", "sequence.teardown.0.timeout_s"),
        (
            "{step: can, timeout_s: 5}",
            "{step: can, timeout_s: -5}",
            "parallel.1.0.timeout_s: Input should be",
        ),
        ("low: 8}", "low: 8, high: 7}", "echoes: the limits are crossed"),
        ("gate: true", "gate: yes", "gate: Input should be a valid boolean"),
        ("gate: true", "gates: true", "gates: Extra inputs"),
        ("low: 4.75", "low: 4.75, low: 0", "key 'low' stands twice"),
        ("deadline_s: 60", "deadline_s: 60\ndeadline_s: 600", "key 'deadline_s' stands twice"),
        ("timeout_s: 2", "timeout_s: 1:30", "teardown.0.timeout_s: Input should be a valid number"),
        ("version: 1.2.3", "version: 1.2", "version: Input should be a valid string"),
        ("testloom-plan/1", "testloom-plan/2", "at format"),
        ("    - {step: power_off, timeout_s: 2}\n", "    []\n", "sequence.teardown"),
        ("sequence:", "sequence: [", "not valid YAML"),
    ],
)
def test_what_is_wrong_with_a_plan_is_named(before, after, says):
    assert before in PLAN
    with pytest.raises(PlanError) as caught:
        plan_of(PLAN.replace(before, after, 1))
    assert says in caught.value.what
    assert caught.value.where == "plans/functional.yaml"
    assert caught.value.fault is Fault.PLAN


@pytest.mark.parametrize("text", ["", "- a\n", "just words", "a: &a [1, *a]", "x" * 1_000_001])
def test_what_is_no_plan_is_refused(text):
    with pytest.raises(PlanError):
        plan_of(text)
