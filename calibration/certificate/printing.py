# pyright: strict
"""A document set in type as PDF/A-3, with the record in it: who has the pages has the numbers too.

English is set in fonts that the typesetter carries, so the same document is the same bytes on every
machine. Chinese is set in a font of the machine, found by name. A letter that no font has is an error.
"""

import io
import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources

import segno
import typst

from calibration.certificate.charts import FONT
from calibration.certificate.document import Document
from protocol.errors import CalibrationError, Fault

LATIN_FAMILY = "Libertinus Serif"
SYMBOL_FAMILY = "DejaVu Sans Mono"
CHINESE_FAMILIES = (
    *("Noto Serif CJK SC", "Source Han Serif SC", "Noto Serif SC"),
    *("Noto Sans CJK SC", "Source Han Sans SC", "Noto Sans SC"),
    *("WenQuanYi Micro Hei", "WenQuanYi Zen Hei", "Droid Sans Fallback", "AR PL UMing CN"),
    *("SimSun", "Microsoft YaHei", "Songti SC", "PingFang SC"),
)
"""In this order: the first that the machine has."""
FIRST_CHINESE = 0x2E80
"""From here on Unicode holds the letters of East Asia."""
STANDARD = "a-3b"


def printed(
    document: Document, records: str | Mapping[str, str], installed: Sequence[str] | None = None
) -> bytes:
    """The PDF.

    Args:
        document: to be set.
        records: JSON of the record, attached to the pages; of several by file name.
        installed: names of the machine's font families; None: look.

    Raises:
        CalibrationError: no font has what is to be printed.
    """
    files, fonts = _files(document, records, installed)
    try:
        return typst.compile(
            files,  # pyright: ignore[reportArgumentType] - the stub forgets files by name
            font_paths=fonts,
            pdf_standards=STANDARD,
            format="pdf",
        )
    except typst.TypstError as error:
        raise _unprintable(str(error.args[0]), document) from None


def pages_as_png(document: Document, records: str | Mapping[str, str], ppi: float) -> list[bytes]:
    """Each page as a picture, for a screen; nothing is attached to it.

    Raises:
        CalibrationError: as `printed`.
    """
    files, fonts = _files(document, records, None)
    try:
        drawn = typst.compile(
            files,  # pyright: ignore[reportArgumentType] - as above
            font_paths=fonts,
            format="png",
            ppi=ppi,
        )
    except typst.TypstError as error:
        raise _unprintable(str(error.args[0]), document) from None
    return drawn if isinstance(drawn, list) else [drawn]


def _files(
    document: Document, records: str | Mapping[str, str], installed: Sequence[str] | None
) -> tuple[dict[str, bytes], typst.Fonts]:
    words = json.dumps(document.as_json(), ensure_ascii=False)
    needs_chinese = any(ord(letter) >= FIRST_CHINESE for letter in words)
    fonts = [LATIN_FAMILY, SYMBOL_FAMILY]
    if needs_chinese:
        fonts.insert(
            1,
            _chinese_family(document, _fonts(of_machine=True).families() if installed is None else installed),
        )
    attached = {"record.json": records} if isinstance(records, str) else dict(records)
    layout = resources.files("calibration.certificate").joinpath("layout.typ").read_bytes()
    files = {
        "main.typ": layout,
        "document.json": words.encode(),
        "fonts.json": json.dumps(fonts).encode(),
        "attached.json": json.dumps(attached, ensure_ascii=False).encode(),
        "qr.svg": qr_svg(document.qr_payload).encode(),
        **{name: svg.replace(FONT, fonts[-2]).encode() for name, svg in document.pictures.items()},
    }
    return files, _fonts(of_machine=needs_chinese)


def qr_svg(payload: str) -> str:
    """The QR code of a text (ISO/IEC 18004, error correction M)."""
    drawn = io.BytesIO()
    segno.make(payload, error="m", micro=False).save(drawn, kind="svg", border=2, xmldecl=False)
    return drawn.getvalue().decode()


@lru_cache(maxsize=2)
def _fonts(of_machine: bool) -> typst.Fonts:
    """Those that the typesetter carries, with those of the machine where wanted: looking takes a while."""
    return typst.Fonts(include_system_fonts=of_machine)


def _chinese_family(document: Document, installed: Sequence[str]) -> str:
    for family in CHINESE_FAMILIES:
        if family in installed:
            return family
    raise CalibrationError(
        "This machine has no font for Chinese.",
        where=document.number,
        fault=Fault.OPERATOR,
        remedy="install one; on Debian: apt-get install fonts-noto-cjk or fonts-wqy-microhei.",
    )


def _unprintable(why: str, document: Document) -> CalibrationError:
    letters = re.search(r"the text `\"(.*)\"` could not be displayed", why)
    if letters is None:
        return CalibrationError(f"The page cannot be set: {why}.", where=document.number)
    return CalibrationError(
        f"No font has the letters '{letters[1]}'.",
        where=document.number,
        fault=Fault.OPERATOR,
        remedy="write them otherwise in the details or the record, or install a font that has them.",
    )
