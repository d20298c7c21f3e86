"""Mistakes that people make on the command line: each is told in a sentence, none with a traceback."""

from pathlib import Path

import pytest

from cli.main import main

PLAN = """
format: testloom-plan/1
name: p
version: 1.0.0
product: gnc_module
operation: functional
deadline_s: 60
sequence:
  main:
    - step: STEP
      timeout_s: 5
      measurements:
        - { name: rail, unit: UNIT, low: LOW, high: 5.25 }
  teardown:
    - step: power_down
      timeout_s: 5
"""


@pytest.mark.parametrize(
    ("step", "unit", "low", "said"),
    [
        ("measure_rails", "V", "5.75", "5.75"),
        ("measure_rails", "Volz", "4.75", "Volz"),
        ("measure_snails", "V", "4.75", "measure_snails"),
    ],
)
def test_a_wrong_plan_is_told_before_a_bench_is_waited_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], step: str, unit: str, low: str, said: str
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN.replace("STEP", step).replace("UNIT", unit).replace("LOW", low))
    options = {
        "--line": "t",
        "--name": "s1",
        "--bench": str(tmp_path / "no_bench.json"),
        "--spool": str(tmp_path / "spool.sqlite"),
        "--recordings": str(tmp_path),
        "--plans": str(plan),
    }
    assert main(["station", *(word for option in options.items() for word in option)]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert str(plan) in error
    assert "no_bench.json" not in error


@pytest.mark.parametrize(
    "arguments",
    [
        ["--lang", "fr", "status"],
        ["status", "--router", "banana"],
        ["order", "--serials", "a b"],
        ["order", "--route", "none"],
        ["up", "--dir", "/proc/x"],
        ["bench", "--name", "b", "--units-dir", "/proc/x", "--description", "/proc/d.json"],
    ],
)
def test_a_mistake_of_the_operator_is_called_so(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    shown = capsys.readouterr()
    assert "Fault: operator" in shown.err
    assert "What to do" in shown.err
    assert shown.out == ""
