"""Plans as files, what steps may measure, and what becomes of step functions that misbehave."""

import itertools
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

from dut_emulator.products.gnc_module.product_limits import PRODUCT_LIMITS
from protocol.errors import Fault, PlanError, TestloomError
from protocol.gnc_module import (
    CONTINUITY_PAIRS,
    GNSS_ANTENNA_HEIGHT_M,
    GNSS_ANTENNA_LATITUDE_DEG,
    GNSS_ANTENNA_LONGITUDE_DEG,
    IMPEDANCE_PAIRS,
    INSULATION_PAIRS,
)
from protocol.measurements import MeasurementOutcome, MeasurementSpecification
from protocol.outcomes import Outcome
from protocol.plans import Plan, Sequence, Step
from protocol.units_of_measure import factor_to_si
from stations.interruptions import AbortFlag, StepError
from stations.sequencing import lane, runner
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import (
    StepDefinition,
    bundled_plans,
    definitions,
    known_steps,
    load_plan,
    step,
)
from stations.steps.interfaces import io_ring
from stations.steps.self_tests import position_error_m

from .conftest import Floor, lease_of

FUNCTIONAL = Path(__file__).parents[2] / "stations" / "plans" / "functional.yaml"


def specifications() -> dict[str, MeasurementSpecification]:
    return {m.name: m for s in bundled_plans()["functional"].steps() for m in s.measurements}


def test_every_pair_of_the_product_is_measured_before_power():
    steps = [s for s in bundled_plans()["functional"].sequence.main if isinstance(s, Step)]
    names = [s.step for s in steps]
    declared = {m.name for s in steps[: names.index("power_up")] for m in s.measurements if s.gate}
    wanted = {
        *(f"continuity_{pair.name}" for pair in CONTINUITY_PAIRS),
        *(f"insulation_{pair.name}" for pair in INSULATION_PAIRS),
        *(f"impedance_{pair.name}" for pair in IMPEDANCE_PAIRS),
    }
    assert wanted <= declared


def test_plan_and_emulator_agree_on_the_products_limits_without_sharing_them():
    """The emulator grades its defects by limits of its own; a limit moved on one side only shows here."""
    compared = 0
    for name, specification in specifications().items():
        limit = PRODUCT_LIMITS.get(name) or PRODUCT_LIMITS.get(name.rsplit("_", 1)[0])
        if limit is None:
            continue
        compared += 1
        factor = factor_to_si(specification.unit)
        if limit.low is not None:
            assert specification.low is not None
            assert specification.low * factor == pytest.approx(limit.low), name
        if limit.high is not None:
            assert specification.high is not None
            assert specification.high * factor == pytest.approx(limit.high), name
        assert specification.standard_uncertainty is not None
        assert specification.standard_uncertainty * factor == pytest.approx(limit.standard_uncertainty), name
    assert compared >= 40


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: p["sequence"]["main"][0]["measurements"][0].update(low=2.0), "limits are crossed"),
        (
            lambda p: p["sequence"]["main"][0]["measurements"][0].update(unit="furlong"),
            "'furlong' is not known",
        ),
        (lambda p: p["sequence"]["main"][0].update(step="measure_luck"), "measure_luck"),
        (lambda p: p["sequence"]["main"][0]["measurements"][0].update(name="luck"), "does not take"),
        (lambda p: p["sequence"].update(teardown=[]), "teardown"),
        (lambda p: p["sequence"]["main"][0].update(timeout_s=-1), "timeout_s"),
    ],
)
def test_a_bad_plan_is_refused_with_its_reason(tmp_path, change, says):
    document = yaml.safe_load(FUNCTIONAL.read_text())
    change(document)
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(PlanError, match=says) as refused:
        load_plan(path)
    assert refused.value.fault is Fault.PLAN
    assert str(path) in refused.value.where


def test_a_plan_that_is_not_there_is_named(tmp_path):
    with pytest.raises(PlanError) as refused:
        load_plan(tmp_path / "absent.yaml")
    assert "absent.yaml" in str(refused.value)


def test_layout_does_not_change_a_plans_hash(tmp_path):
    path = tmp_path / "same.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(FUNCTIONAL.read_text()), sort_keys=True))
    assert load_plan(path).sha256() == load_plan(FUNCTIONAL).sha256()


def test_two_functions_may_not_share_a_name():
    assert "test_cpu" in known_steps()
    with pytest.raises(TestloomError, match="test_cpu"):
        step("test_cpu")(lambda context: None)


def context_of(*measurements: MeasurementSpecification) -> StepContext:
    declared = Step(step="any", timeout_s=1.0, measurements=measurements)
    return StepContext(declared, None, None, None)  # type: ignore[arg-type]


def test_values_come_in_si_and_are_judged_in_the_plans_unit():
    rate = MeasurementSpecification(name="rate", unit="deg/s", low=-1.0, high=1.0)
    error = MeasurementSpecification(name="error", unit="ppm", high=200.0)
    count = MeasurementSpecification(name="count", unit="count", equals=3)
    context = context_of(rate, error, count)
    context.measure("rate", float(np.radians(0.5)))
    context.measure("error", 2.5e-4)
    context.measure("count", 3)
    taken = context.measurements()
    assert [m.value for m in taken] == [pytest.approx(0.5), pytest.approx(250.0), 3]
    assert [m.outcome.value for m in taken] == ["PASS", "FAIL", "PASS"]


def test_a_value_that_is_not_finite_is_an_error_and_nothing_taken_is_unset():
    one, two = (MeasurementSpecification(name=name, unit="V", high=1.0) for name in ("one", "two"))
    context = context_of(one, two)
    context.measure("one", float("nan"))
    taken = context.measurements()
    assert [m.outcome for m in taken] == [MeasurementOutcome.ERROR, MeasurementOutcome.UNSET]
    assert taken[0].value is None


def test_an_undeclared_measurement_is_the_steps_error():
    with pytest.raises(StepError, match="undeclared"):
        context_of().measure("undeclared", 1.0)


def test_the_io_ring_uses_each_line_once_and_depends_on_the_attempt():
    rings = {io_ring(f"attempt-{number}") for number in range(200)}
    assert all(sorted(ring) == [0, 1, 2, 3] for ring in rings)
    assert io_ring("attempt-1") == io_ring("attempt-1")
    assert len(rings) == len(list(itertools.permutations(range(4))))


def test_position_errors_are_metres():
    """One second of latitude is 30.8 m, one of longitude 25.6 m at 34.2° (WGS 84 series)."""
    here = (
        np.radians(GNSS_ANTENNA_LATITUDE_DEG),
        np.radians(GNSS_ANTENNA_LONGITUDE_DEG),
        GNSS_ANTENNA_HEIGHT_M,
    )
    second = np.radians(1 / 3600)
    assert position_error_m(*here) == pytest.approx(0.0, abs=1e-6)
    assert position_error_m(here[0], here[1], here[2] + 7.0) == pytest.approx(7.0, abs=1e-6)
    assert position_error_m(here[0] + second, here[1], here[2]) == pytest.approx(30.81, abs=0.02)
    assert position_error_m(here[0], here[1] + second, here[2]) == pytest.approx(25.61, abs=0.02)


def small_plan(*main: Step) -> Plan:
    return Plan(
        format="testloom-plan/1",
        name="small",
        version="1.0.0",
        product="gnc_module",
        operation="functional",
        deadline_s=100.0,
        sequence=Sequence(main=main, teardown=(Step(step="power_down", timeout_s=5.0),)),
    )


@pytest.fixture
def odd_steps(monkeypatch):
    """Steps that misbehave, known to lanes for one test."""
    release = threading.Event()

    def crash(context: StepContext) -> None:
        raise ZeroDivisionError("of its own making")

    def oversleep(context: StepContext) -> None:
        context.clock.sleep_until(context.clock.now_s() + 1000.0)

    def hang(context: StepContext) -> None:
        release.wait(60)

    odd = {f.__name__: StepDefinition(f.__name__, f, frozenset()) for f in (crash, oversleep, hang)}
    everything = {**definitions(), **odd}
    monkeypatch.setattr(lane, "definitions", lambda: everything)
    yield
    release.set()


@pytest.mark.parametrize(
    ("name", "outcome", "fault", "says"),
    [
        ("crash", Outcome.ERROR, Fault.TESTLOOM, "ZeroDivisionError: of its own making"),
        ("oversleep", Outcome.TIMEOUT, Fault.FIXTURE, "presence contact is open"),
        ("hang", Outcome.ERROR, Fault.TESTLOOM, "has not come back"),
    ],
)
def test_a_step_that_misbehaves_ends_and_the_teardown_runs(
    floor: Floor, odd_steps, monkeypatch, name, outcome, fault, says
):
    monkeypatch.setattr(runner, "STEP_GUARD_WALL_S", 0.2 if name == "hang" else 60.0)
    plan = small_plan(Step(step=name, timeout_s=0.3))
    result = floor.runners["1"].run(plan, lease_of(plan, "NOBODY"), lambda progress: None, AbortFlag())
    assert (result.outcome, result.fault) == (outcome, fault), result.message
    assert says in result.message
    assert [s.step for s in result.steps] == [name, "power_down"]
    assert result.safe_state


def test_a_progress_view_that_breaks_costs_nothing(floor: Floor):
    def broken(progress) -> None:
        raise RuntimeError("nobody listens")

    plan = small_plan(Step(step="power_down", timeout_s=5.0))
    result = floor.runners["1"].run(plan, lease_of(plan, "NOBODY"), broken, AbortFlag())
    assert result.outcome is Outcome.PASS
