"""Which plan a station runs an operation with."""

from importlib import resources
from pathlib import Path

import pytest

from protocol.errors import PlanError
from stations.agent.shell import load_plans

PAPER_PLAN = Path(str(resources.files("stations"))) / "plans" / "imu_calibration_paper.yaml"


def _by_operation(*places: Path) -> dict[str, str]:
    return {plan.operation: plan.name for plan in load_plans(places)}


def test_the_bundled_plan_of_an_operation_is_the_one_named_so() -> None:
    assert _by_operation() == {"functional": "functional", "imu_calibration": "imu_calibration"}


def test_a_given_plan_takes_the_place_of_the_bundled_one() -> None:
    assert _by_operation(PAPER_PLAN)["imu_calibration"] == "imu_calibration_paper"


def test_two_given_plans_for_one_operation_are_refused(tmp_path: Path) -> None:
    copy = tmp_path / "other.yaml"
    copy.write_text(PAPER_PLAN.read_text().replace("name: imu_calibration_paper", "name: other"))
    with pytest.raises(PlanError, match="Two plans"):
        load_plans((PAPER_PLAN, copy))
