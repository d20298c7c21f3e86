"""How pictures look, and which fonts have Chinese."""

from typing import Any

from matplotlib import font_manager

from dut_emulator.picture_style import STYLE
from protocol.language import chosen_language

_CHINESE_FONTS = (
    "Noto Sans CJK SC",
    "Source Han Sans SC",
    "WenQuanYi Zen Hei",
    "Microsoft YaHei",
    "PingFang SC",
)


def picture_style() -> Any:
    """Settings of matplotlib. Chinese needs a font that has it; without one the words stay as they are."""
    there = {font.name for font in font_manager.fontManager.ttflist}
    chinese = [font for font in _CHINESE_FONTS if font in there] if chosen_language() == "zh" else []
    return {**STYLE, "font.family": [*chinese, *STYLE["font.family"]]}
