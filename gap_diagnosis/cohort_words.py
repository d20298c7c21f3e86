# pyright: strict
"""Words for the levels of a cohort."""

from collections.abc import Mapping

from gap_diagnosis.cohort import LINK, NOT_TOLD_APART, NOTHING, EffectFindings
from protocol.language import say

LEVEL_WORDS: Mapping[str, str] = {
    "unit": "unit",
    "lot": "lot",
    "stand": "stand",
    "mount": "mount",
    LINK: "link",
    NOTHING: "nothing",
    NOT_TOLD_APART: "not told apart",
}


def level_words(name: str) -> str:
    """'unit', 'lot' …"""
    return say(LEVEL_WORDS[name])


def assigned_words(one: EffectFindings) -> str:
    """The level; or 'not told apart: lot, stand'."""
    if len(one.between) == 1:
        return level_words(one.between[0])
    return f"{level_words(NOT_TOLD_APART)}: {', '.join(level_words(name) for name in one.between)}"
