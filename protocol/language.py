"""What a person reads, in English and Chinese.

English is the key: `say("{count} units", count=3)`. Each package with words for people keeps a
`zh.json` beside its `__init__.py`, English template → Chinese template; a word that is missing
there is shown in English. A test holds the catalogues against the code.
"""

import json
import os
from functools import lru_cache
from importlib import resources

LANGUAGES = ("en", "zh")
ENVIRONMENT_VARIABLE = "TESTLOOM_LANG"
PACKAGES_WITH_WORDS = ("protocol", "calibration", "stations", "coordinator", "dashboards", "cli")

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


@lru_cache(maxsize=1)
def _chinese() -> dict[str, str]:
    words: dict[str, str] = {}
    for package in PACKAGES_WITH_WORDS:
        catalogue = resources.files(package).joinpath("zh.json")
        if catalogue.is_file():
            words.update(json.loads(catalogue.read_text(encoding="utf-8")))
    return words
