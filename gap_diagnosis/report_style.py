# pyright: strict
"""How report.html looks: a sheet for desk, phone and paper, colours that are told apart by everyone."""

from importlib import resources
from typing import Final

from dut_emulator.picture_style import COLOURS
from gap_diagnosis.report import Verdict

BLUE, VERMILION, GREEN, GREY = COLOURS
VERDICT_COLOURS: Final[dict[Verdict, str]] = {
    "no_gap": GREEN,
    "attributed": BLUE,
    "confusable": "#e69f00",
    "unattributed": VERMILION,
}
FULL_SIGMAS = 8.0
"""From so many standard deviations on, a cell has the full colour."""
DARK_INK_UNTIL = 0.6

STYLE_SHEET: Final = resources.files("gap_diagnosis").joinpath("report.css").read_text(encoding="utf-8")


def heat_colour(sigmas: float) -> tuple[str, str]:
    """(ground, ink): white for nothing, through orange to dark red."""
    share = min(abs(sigmas) / FULL_SIGMAS, 1.0)
    stops = ((255, 255, 255), (253, 187, 132), (179, 0, 0))
    at = share * (len(stops) - 1)
    left = min(int(at), len(stops) - 2)
    mixed = (
        round(one + (at - left) * (other - one))
        for one, other in zip(stops[left], stops[left + 1], strict=True)
    )
    red, green, blue = mixed
    return f"#{red:02x}{green:02x}{blue:02x}", "#1a1a1a" if share < DARK_INK_UNTIL else "#fff"
