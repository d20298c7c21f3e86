"""Steps by name: what plans may call, and what each can measure."""

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.errors import Fault, PlanError, TestloomError
from protocol.plans import Plan, parse_plan

if TYPE_CHECKING:
    from stations.sequencing.context import StepContext

StepFunction = Callable[["StepContext"], None]

_registered: dict[str, "StepDefinition"] = {}


@dataclass(frozen=True)
class StepDefinition:
    """A step function and the names of all measurements that it can take."""

    name: str
    function: StepFunction
    measurements: frozenset[str]


def step(name: str, measurements: Iterable[str] = ()) -> Callable[[StepFunction], StepFunction]:
    """Register a function as the step `name`; the decorated function stays as it is.

    Raises:
        TestloomError: another function has this name already.
    """

    def register(function: StepFunction) -> StepFunction:
        known = _registered.get(name)
        if known is not None and known.function.__qualname__ != function.__qualname__:
            raise TestloomError(
                f"Two step functions are called '{name}'.",
                where=f"{known.function.__module__} and {function.__module__}",
                remedy="rename one of them.",
            )
        _registered[name] = StepDefinition(name, function, frozenset(measurements))
        return function

    return register


@lru_cache(maxsize=1)
def definitions() -> Mapping[str, StepDefinition]:
    """All steps of `stations.steps`, by name."""
    import stations.steps

    for module in pkgutil.iter_modules(stations.steps.__path__):
        importlib.import_module(f"stations.steps.{module.name}")
    return dict(_registered)


def known_steps() -> Mapping[str, frozenset[str]]:
    """Step name → measurements that it can take, as `protocol.plans.parse_plan` wants it."""
    return {name: definition.measurements for name, definition in definitions().items()}


def load_plan(path: Path) -> Plan:
    """The checked plan of a file.

    Raises:
        PlanError: the file cannot be read or its plan cannot be used.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise PlanError(
            f"The plan cannot be read: {error}.",
            where=str(path),
            fault=Fault.PLAN,
            remedy="give the name of a readable YAML file.",
        ) from None
    return parse_plan(text, where=str(path), known_steps=known_steps())


def bundled_plans() -> dict[str, Plan]:
    """The plans that come with the product, by file name without its ending."""
    folder = resources.files("stations").joinpath("plans")
    return {
        entry.name.removesuffix(".yaml"): parse_plan(
            entry.read_text(encoding="utf-8"), where=entry.name, known_steps=known_steps()
        )
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith(".yaml")
    }
