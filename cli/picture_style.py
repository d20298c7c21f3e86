"""How pictures look, and which fonts have Chinese."""

from typing import Any

from matplotlib import font_manager

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
    return {
        "font.family": [*chinese, "DejaVu Sans"],
        "axes.unicode_minus": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "font.size": 9,
        "lines.linewidth": 1.3,
    }
