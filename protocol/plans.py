"""Plans: versioned, hashed sequences of steps with their measurements and limits.

A plan is data. It is checked whole when it is loaded, so that a crossed limit, an unknown unit
or an unknown step is found before a unit is touched. Two plans with the same content have the
same hash, whatever the layout of their files.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

import yaml
from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from protocol.errors import Fault, PlanError
from protocol.frozen_model import FrozenModel, first_problem
from protocol.measurements import MeasurementSpecification, Value
from protocol.plan_yaml import load_plan_yaml

ParameterValue = Value | tuple[float, ...] | tuple[str, ...]

MAX_PLAN_BYTES = 1_000_000


class Step(FrozenModel):
    """One step: the function that does it, its time-out, and what it measures.

    `gate`: when this step does not pass, nothing after it runs but the teardown (a shorted rail
    must never be powered). `timeout_s` is bench time.
    """

    step: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    timeout_s: float = Field(gt=0, le=36_000)
    gate: bool = False
    parameters: dict[str, ParameterValue] = Field(default_factory=dict)
    measurements: tuple[MeasurementSpecification, ...] = ()


class Parallel(FrozenModel):
    """Branches that run side by side, each on interfaces of its own; all end before the next item."""

    parallel: tuple[tuple[Step, ...], ...] = Field(min_length=2, max_length=8)


def _kind_of_item(item: object) -> str:
    """So that an error in a branch is told as that, not as everything that keeps it from being a step."""
    parallel = "parallel" in item if isinstance(item, Mapping) else isinstance(item, Parallel)
    return "Parallel" if parallel else "Step"


Item = Annotated[
    Annotated[Step, Tag("Step")] | Annotated[Parallel, Tag("Parallel")], Discriminator(_kind_of_item)
]


class Sequence(FrozenModel):
    """setup, main and teardown; teardown always runs, to its end, whatever happened before."""

    setup: tuple[Step, ...] = ()
    main: tuple[Item, ...] = Field(min_length=1)
    teardown: tuple[Step, ...] = Field(min_length=1)


class PlanReference(FrozenModel):
    """What binds an attempt to the exact plan that was run."""

    operation: str
    name: str
    version: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Plan(FrozenModel):
    """A test plan of one operation on one product."""

    format: Literal["testloom-plan/1"]
    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    version: str = Field(pattern=r"^\d+\.\d+\.\d+$")
    product: str
    operation: str
    description: str = ""
    deadline_s: float = Field(gt=0, le=360_000)
    sequence: Sequence

    @model_validator(mode="after")
    def _names_are_unique(self) -> "Plan":
        seen: set[str] = set()
        for step in self.steps():
            for measurement in step.measurements:
                if measurement.name in seen:
                    raise ValueError(f"measurement {measurement.name} is declared twice")
                seen.add(measurement.name)
        return self

    def steps(self) -> Iterator[Step]:
        """All steps in the order in which they stand: setup, main, teardown."""
        yield from self.sequence.setup
        for item in self.sequence.main:
            if isinstance(item, Parallel):
                for branch in item.parallel:
                    yield from branch
            else:
                yield item
        yield from self.sequence.teardown

    def sha256(self) -> str:
        """SHA-256 of the canonical JSON form (sorted keys, no white space), in hex."""
        canonical = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()

    def reference(self) -> PlanReference:
        """The plan's name, version and hash."""
        return PlanReference(
            operation=self.operation, name=self.name, version=self.version, sha256=self.sha256()
        )


def parse_plan(text: str, *, where: str, known_steps: Mapping[str, frozenset[str]]) -> Plan:
    """A checked plan from YAML text.

    Args:
        text: the YAML document.
        where: file name, for errors.
        known_steps: step name → names of the measurements that this step can take.

    Raises:
        PlanError: the text is no plan, or names a unit, a step or a measurement that is not
            known, or has crossed limits. The message names the place.
    """
    if len(text) > MAX_PLAN_BYTES:
        raise _refused(f"The plan is larger than {MAX_PLAN_BYTES} bytes.", where)
    try:
        document = load_plan_yaml(text)
    except yaml.YAMLError as error:
        raise _refused(f"The plan is not valid YAML: {' '.join(str(error).split())}.", where) from None
    if not isinstance(document, dict):
        raise _refused("The plan is not a YAML mapping.", where)
    try:
        plan = Plan.model_validate_json(json.dumps(document))
    except ValidationError as error:
        raise _refused(f"The plan cannot be used: {first_problem(error)}.", where) from None
    except (TypeError, ValueError) as error:  # YAML can say what JSON cannot
        raise _refused(f"The plan cannot be used: {error}.", where) from None
    for step in plan.steps():
        if step.step not in known_steps:
            raise _refused(
                f"The plan names a step '{step.step}' that this station does not know; "
                f"it knows: {', '.join(sorted(known_steps))}.",
                where,
            )
        for measurement in step.measurements:
            if measurement.name not in known_steps[step.step]:
                raise _refused(
                    f"Step '{step.step}' does not take a measurement '{measurement.name}'; "
                    f"it takes: {', '.join(sorted(known_steps[step.step])) or 'none'}.",
                    where,
                )
    return plan


def _refused(what: str, where: str) -> PlanError:
    return PlanError(what, where=where, fault=Fault.PLAN, remedy="correct the plan and load it again.")
