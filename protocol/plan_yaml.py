# pyright: strict
"""YAML as a plan means it: the words of YAML 1.2 (core schema), and no key twice.

PyYAML reads YAML 1.1, where `no` is false, `1:30` is 90, `010` is 8, `1e-3` is a text and the second
of two equal keys silently wins: a limit could change without a word.
"""

import re
from typing import Any

import yaml
from yaml.nodes import MappingNode, ScalarNode


class _PlanLoader(yaml.SafeLoader):
    """SafeLoader with the core schema of YAML 1.2."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - PyYAML's own form

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            word = str(key.value) if isinstance(key, ScalarNode) else ""
            if word in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key '{word}' stands twice in one mapping", key.start_mark
                )
            seen.add(word)
        return super().construct_mapping(node, deep)


_CORE_SCHEMA = (
    ("null", r"(~|null|)$", [*"~n", ""]),
    ("bool", r"(true|false)$", [*"tf"]),
    ("int", r"[-+]?(0|[1-9][0-9]*)$", [*"-+0123456789"]),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$", [*"-+.0123456789"]),
    ("float", r"([-+]?\.inf|\.nan)$", [*"-+."]),
)
for _tag, _pattern, _first_characters in _CORE_SCHEMA:
    for _character in _first_characters:
        _PlanLoader.yaml_implicit_resolvers.setdefault(_character, []).append(
            (f"tag:yaml.org,2002:{_tag}", re.compile(_pattern))
        )


def load_plan_yaml(text: str) -> object:
    """The document in this text.

    Raises:
        yaml.YAMLError: it is no YAML, or has a key twice.
    """
    return yaml.load(text, Loader=_PlanLoader)  # a SafeLoader
