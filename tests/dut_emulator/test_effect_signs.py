"""Each plus, minus and negation of the deterministic effects is turned round by itself: the suite notices."""

import ast
import copy
import dataclasses
import inspect
import types
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from dut_emulator.effects import (
    couplings,
    deterministic,
    dynamics,
    fields_and_tones,
    link,
    nonlinearity,
    stand,
    stand_surroundings,
    thermal,
)
from dut_emulator.effects.parameters import scalars, with_values
from tests.dut_emulator.effect_examples import DETERMINISTIC, EXAMPLES, applied, at_neutral, motion
from tests.dut_emulator.effect_oracles import ORACLES

MODULES = (
    couplings,
    deterministic,
    dynamics,
    fields_and_tones,
    link,
    nonlinearity,
    stand,
    stand_surroundings,
    thermal,
)
WHOLE = motion()
NOT_PHYSICS = {"guess", "variance", "__init__", "is_neutral"}
LEAST_SIGNS = 40
NOT_NEUTRAL_AT_0 = {"saturation", "quantization", "counter_wrap"}
DETERMINISTIC_EXAMPLES = [EXAMPLES[name] for name in DETERMINISTIC]


def signs_in(tree: ast.Module, kinds: set[str]) -> Iterator[tuple[str | None, ast.AST]]:
    """(class, or None for a function of the module; node) of every sign in the arithmetic."""
    for item in tree.body:
        if isinstance(item, ast.FunctionDef):
            yield from ((None, node) for node in ast.walk(item) if is_sign(node))
        if isinstance(item, ast.ClassDef) and item.name in kinds:
            for method in item.body:
                if isinstance(method, ast.FunctionDef) and method.name not in NOT_PHYSICS:
                    yield from ((item.name, node) for node in ast.walk(method) if is_sign(node))


def is_sign(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add | ast.Sub)
    return isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)


def turned_round(node: Any) -> None:
    if isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd()
    else:
        node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()


def mutants(module: types.ModuleType, kinds: set[str]) -> Iterator[tuple[str, str | None, dict[str, Any]]]:
    """(place, class, namespace of the module with one sign turned round)."""
    original = ast.parse(inspect.getsource(module))
    count = sum(1 for _ in signs_in(original, kinds))
    for number in range(count):
        tree = copy.deepcopy(original)
        name, node = list(signs_in(tree, kinds))[number]
        before = ast.unparse(node)
        turned_round(node)
        namespace: dict[str, Any] = {"__name__": module.__name__}
        exec(compile(tree, module.__file__ or "", "exec"), namespace)
        place = f"{module.__name__}:{node.lineno} {before} → {ast.unparse(node)}"  # type: ignore[attr-defined]
        yield place, name, namespace


def is_noticed(effect: Any, kind: Any, expected: np.ndarray) -> bool:
    """As in the conformance suite: the oracle, and the derivative here and where the effect begins."""
    samples = WHOLE.true_input(effect.sensor)
    try:
        out = applied(in_kind(kind, effect), samples, WHOLE)
        allowed = 1e-7 * np.abs(expected - samples).max() + 1e-12 * np.abs(samples).max()
        if out.shape != expected.shape or not np.abs(out - expected).max() <= allowed:
            return True
        points = [effect] if effect.word in NOT_NEUTRAL_AT_0 else [effect, at_neutral(effect)]
        return any(has_wrong_basis(effect, point, in_kind(kind, point), samples) for point in points)
    except (ValueError, IndexError, ZeroDivisionError):
        return True


def in_kind(kind: Any, effect: Any) -> Any:
    """A mutant's class with an effect's parameters."""
    return kind(**{item.name: getattr(effect, item.name) for item in dataclasses.fields(effect)})


def has_wrong_basis(effect: Any, point: Any, mutant: Any, samples: np.ndarray) -> bool:
    columns = mutant.basis(WHOLE)
    start = applied(point, samples, WHOLE)
    size = max(abs(scalar.value) for scalar in scalars(effect, free_only=True))
    step = (1e-8 if effect.word == "quantization" else 1e-5) * size
    for scalar in scalars(point, free_only=True):
        moved = applied(with_values(point, {scalar.name: scalar.value + step}), samples, WHOLE)
        column = columns[scalar.name]
        allowed = 1e-3 * np.abs(column).max() + 1e-13 * np.abs(samples).max() / step
        if not np.abs((moved - start) / step - column).max() <= allowed:
            return True
    return False


@pytest.mark.slow
@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.rsplit(".", 1)[1])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_sign_turned_round_is_noticed(module: types.ModuleType) -> None:
    own = module.__name__
    examples = [effect for effect in DETERMINISTIC_EXAMPLES if type(effect).__module__ == own]
    # a base class is in force through its subclasses
    lines = {e: {base.__name__ for base in type(e).__mro__ if base.__module__ == own} for e in examples}
    expected = {e: np.array(ORACLES[e.word](e, WHOLE.true_input(e.sensor), WHOLE)) for e in examples}
    unnoticed = [
        place
        for place, name, namespace in mutants(module, set().union(*lines.values()))
        if not any(
            is_noticed(e, namespace[type(e).__name__], expected[e])
            for e in examples
            if name is None or name in lines[e]
        )
    ]
    assert not unnoticed, "\n".join(unnoticed)


def test_there_are_signs_to_turn_round() -> None:
    trees = [(ast.parse(inspect.getsource(module)), module) for module in MODULES]
    count = sum(
        len(list(signs_in(tree, {name for name in vars(module) if isinstance(vars(module)[name], type)})))
        for tree, module in trees
    )
    assert count >= LEAST_SIGNS
