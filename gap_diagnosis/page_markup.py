# pyright: strict
"""What the pages of reports and cohorts are made of: the file around them, sections, tables, bars."""

from collections.abc import Iterable, Sequence
from html import escape

from gap_diagnosis.report_style import STYLE_SHEET
from gap_diagnosis.report_words import percent
from protocol.language import chosen_language


def page(title: str, parts: Iterable[str]) -> str:
    """One file without a network; `parts` are markup."""
    return (
        f'<!DOCTYPE html>\n<html lang="{chosen_language()}">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE_SHEET}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def section(title: str, body: str) -> str:
    """`body` is markup."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>"


def cards(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are markup. On a phone each row is a card: every cell says what it is."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td data-is="{escape(heading)}">{cell}</td>'
            for heading, cell in zip(headings, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table class=cards><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def bar(share: float) -> str:
    """A share from 0 to 1 as a bar with its percentage."""
    drawn = f'<span class=bar><i style="width:{round(100 * share)}%"></i></span>'
    return f"<span class=chance>{drawn} {escape(percent(share))}</span>"
