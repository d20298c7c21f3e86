"""What a person reads, in English and Chinese.

English is the key: `say("{count} units", count=3)`. Each package with words for people keeps a
`zh.json` beside its `__init__.py`, English template → Chinese template; a word that is missing
there is shown in English. A test holds the catalogues against the code.
"""

import json
import os
import re
from functools import lru_cache
from importlib import resources

LANGUAGES = ("en", "zh")
ENVIRONMENT_VARIABLE = "TESTLOOM_LANG"
PACKAGES_WITH_WORDS = (
    *("protocol", "calibration", "gap_diagnosis"),
    *("stations", "coordinator", "dashboards", "cli"),
)
MIN_OWN_WORDS = 5
"""Characters that a template must have beside its fields to be recognised in a sentence."""
VERDICTS = frozenset({"agree", "clear", "source", "verdict", "what"})
"""Fields that hold words even where they hold one only."""
_PLAIN_FIELD = re.compile(r"\{([a-z_]+)\}")

_chosen: list[str] = []


def choose_language(language: str) -> None:
    """Speak this language from now on, in this process.

    Raises:
        ValueError: not one of `LANGUAGES`.
    """
    if language not in LANGUAGES:
        raise ValueError(f"'{language}' is not one of: {', '.join(LANGUAGES)}")
    _chosen[:] = [language]


def chosen_language() -> str:
    """The language chosen in this process, else TESTLOOM_LANG, else English."""
    if _chosen:
        return _chosen[0]
    from_environment = os.environ.get(ENVIRONMENT_VARIABLE, "en")[:2].lower()
    return from_environment if from_environment in LANGUAGES else "en"


def say(template: str, /, language: str | None = None, **values: object) -> str:
    """The template in the chosen language, with its values filled in."""
    if (language or chosen_language()) == "zh":
        template = _chinese().get(template, template)
    return template.format(**values) if values else template


def translated(sentence: str, language: str | None = None) -> str:
    """An English sentence that is filled in already, an error's say, in the chosen language.

    The catalogue's templates are read backwards, those with the most words of their own first:
    'No route {route}.' recognises 'No route x.'. A field that holds words, not a name, is read in the same
    way. What no template makes stays English.
    """
    if (language or chosen_language()) != "zh" or not sentence:
        return sentence
    if sentence in _chinese():
        return _chinese()[sentence]
    for pattern, chinese in _chinese_by_pattern():
        found = pattern.fullmatch(sentence)
        if found is not None:
            fields = found.groupdict().items()
            return chinese.format(**{name: _in_a_field(name, text) for name, text in fields})
    return sentence


def _in_a_field(name: str, text: str) -> str:
    return translated(text, "zh") if " " in text or name in VERDICTS else text


@lru_cache(maxsize=1)
def _chinese_by_pattern() -> list[tuple[re.Pattern[str], str]]:
    """Templates as patterns; those that format numbers cannot be read backwards and are left out."""
    patterns: list[tuple[int, re.Pattern[str], str]] = []
    for english, chinese in _chinese().items():
        parts = _PLAIN_FIELD.split(english)  # words, field, words, field, …, words
        names, words = parts[1::2], parts[0::2]
        own = sum(len(text.strip()) for text in words)
        if not names or len(set(names)) < len(names) or own < MIN_OWN_WORDS or "{" in "".join(words):
            continue
        groups = [*(f"(?P<{name}>.+?)" for name in names), ""]
        pattern = "".join(re.escape(text) + group for text, group in zip(words, groups, strict=True))
        patterns.append((own, re.compile(pattern, re.DOTALL), chinese))
    return [(pattern, chinese) for _, pattern, chinese in sorted(patterns, key=lambda one: -one[0])]


@lru_cache(maxsize=1)
def _chinese() -> dict[str, str]:
    words: dict[str, str] = {}
    for package in PACKAGES_WITH_WORDS:
        catalogue = resources.files(package).joinpath("zh.json")
        if catalogue.is_file():
            words.update(json.loads(catalogue.read_text(encoding="utf-8")))
    return words
