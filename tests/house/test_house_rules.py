"""The house rules that a program can hold: words in both languages, names, sizes, tool-free texts."""

import ast
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    *("protocol", "calibration", "dut_emulator", "gap_diagnosis", "stations"),
    *("coordinator", "dashboards", "cli"),
)
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
FORBIDDEN_NAMES = re.compile(r"(^|_)(utils?|manager|helpers?|misc)(_|$)")
OTHER_NAMES_IN_CHINESE = ("工位", "测试座", "台架", "报警", "良率", "调度器")
"""Words for what is called 测试站, 插座, 测试台, 告警, 合格率, 协调器 here."""
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60


def _said(path: Path) -> set[str]:
    """Templates that a file says: literal first arguments of say()."""
    words: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "say"):
            continue
        if node.args and isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str):
            words.add(node.args[0].value)
    return words


def _catalogue(package: str) -> dict[str, str]:
    path = ROOT / package / "zh.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def test_everything_that_is_said_is_said_in_chinese() -> None:
    chinese: dict[str, str] = {}
    for package in PACKAGES:
        chinese |= _catalogue(package)
    missing = {
        f"{path.relative_to(ROOT)}: {words}"
        for path in SOURCES
        for words in _said(path)
        if words not in chinese and re.search(r"[A-Za-z]{2}", words)
    }
    assert not missing, "\n".join(sorted(missing))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_translation_has_the_fields_of_its_template(package: str) -> None:
    field = re.compile(r"\{([a-z_]*)")
    catalogue = _catalogue(package)
    wrong = {
        english: chinese
        for english, chinese in catalogue.items()
        if sorted(field.findall(english)) != sorted(field.findall(chinese))
    }
    assert not wrong
    assert list(catalogue) == sorted(catalogue), "keep the catalogue sorted"


def test_a_thing_has_one_name_in_chinese() -> None:
    translations: dict[str, set[str]] = {}
    for package in PACKAGES:
        for english, chinese in _catalogue(package).items():
            translations.setdefault(english, set()).add(chinese)
    assert [english for english, chinese in translations.items() if len(chinese) > 1] == []
    strange = [
        f"{word}: {chinese}"
        for word in OTHER_NAMES_IN_CHINESE
        for several in translations.values()
        for chinese in several
        if word in chinese
    ]
    assert not strange, "\n".join(strange)


def test_files_and_functions_stay_readable() -> None:
    too_long: list[str] = []
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if text.count("\n") > MAX_FILE_LINES:
            too_long.append(f"{path.relative_to(ROOT)} has {text.count(chr(10))} lines")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > MAX_FUNCTION_LINES:
                    too_long.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name} has {length} lines")
    assert not too_long, "\n".join(too_long)


def test_names_say_what_a_thing_is() -> None:
    vague = [str(path.relative_to(ROOT)) for path in SOURCES if FORBIDDEN_NAMES.search(path.stem)]
    vague += [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and FORBIDDEN_NAMES.search(node.name.lower())
    ]
    assert not vague


def test_every_package_says_what_lives_there() -> None:
    for package in PACKAGES:
        module = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
        assert ast.get_docstring(module), package


def test_every_dependency_has_its_reason() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    declared = re.search(r"^dependencies = \[(.*?)^\]", project, re.DOTALL | re.MULTILINE)
    assert declared
    names = re.findall(r'"([A-Za-z0-9-]+)', declared.group(1))
    reasons = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    assert len(names) > 10
    assert [name for name in names if name not in reasons] == []
