# pyright: strict
"""A document as its parts, before it is set in type: what `layout.typ` prints and the JSON holds."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from protocol.language import say as spoken

Say = Callable[..., str]


@dataclass(frozen=True)
class Facts:
    """Labels with their values; a value with white space at its ends was not given."""

    rows: tuple[tuple[str, str], ...]
    kind: Literal["facts"] = "facts"


@dataclass(frozen=True)
class Paragraph:
    """A paragraph. `tone`: a warning is framed, a note is small."""

    text: str
    tone: Literal["plain", "note", "warning"] = "plain"
    kind: Literal["paragraph"] = "paragraph"


@dataclass(frozen=True)
class Bullets:
    """Sentences below each other."""

    items: tuple[str, ...]
    kind: Literal["bullets"] = "bullets"


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        title: above it; may be empty.
        headings: one for each column.
        rows: of texts. One that starts with `$` is a symbol, as K_2x is, and is set as one; the words
            'good', 'bad', 'open' before '|' colour what follows; 'part|' goes before a percentage, drawn
            as a bar.
        align: 'l', 'r' or 'c' for each column.
        note: below it; may be empty.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    align: str
    note: str = ""
    kind: Literal["grid"] = "grid"

    def __post_init__(self) -> None:
        widths = {len(self.headings), len(self.align), *(len(row) for row in self.rows)}
        if len(widths) != 1:
            raise ValueError(f"the table '{self.title}' is not rectangular")


@dataclass(frozen=True)
class Picture:
    """A drawing, by the name of its SVG. `width`: part of the page's text width."""

    name: str
    caption: str
    width: float = 1.0
    kind: Literal["picture"] = "picture"


@dataclass(frozen=True)
class Correlations:
    """Lower triangle of a matrix of correlation coefficients. `symbols`: as cells of a `Grid` are."""

    symbols: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str
    kind: Literal["correlations"] = "correlations"


@dataclass(frozen=True)
class Signatures:
    """Lines to sign on: who does what, and the name where it is known."""

    rows: tuple[tuple[str, str], ...]
    date: str
    kind: Literal["signatures"] = "signatures"


@dataclass(frozen=True)
class Contents:
    """The parts of a document and the pages that they begin on, found when it is set.

    Attributes:
        headings: of the columns, that of the page last.
        rows: of texts, one for each part, whose heading is the first text.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    kind: Literal["contents"] = "contents"


Block = Contents | Facts | Paragraph | Bullets | Grid | Picture | Correlations | Signatures


@dataclass(frozen=True)
class Section:
    """A heading and what is under it. `level`: 2 within a part of several records."""

    title: str
    blocks: tuple[Block, ...]
    level: Literal[1, 2] = 1


@dataclass(frozen=True)
class Document:
    """Everything on the pages.

    Attributes:
        title, subtitle: of the first page.
        number: in the header of every page.
        language: en or zh.
        laboratory: lines at the head of the first page.
        identity: SHA-256 of the record, in the footer.
        qr_payload: what the QR code says.
        qr_caption: below it.
        footer: sentence at the foot of every page.
        page_words: with {page} and {pages} where the numbers go.
        number_word: before the number.
        created: year, month, day of the record.
        sections: in order.
        pictures: SVG by name.
        end_words: below the last line, so that nobody can add to it.
    """

    title: str
    subtitle: str
    number: str
    language: str
    laboratory: tuple[str, ...]
    identity: str
    qr_payload: str
    qr_caption: str
    footer: str
    page_words: str
    number_word: str
    created: tuple[int, int, int]
    end_words: str
    sections: tuple[Section, ...]
    pictures: dict[str, str] = field(default_factory=dict[str, str])

    def as_json(self) -> dict[str, Any]:
        """All but the pictures."""
        return {key: value for key, value in asdict(self).items() if key != "pictures"}


def speaker(language: str) -> Say:
    """`say` in one language, whatever this process speaks."""

    def say(template: str, /, **values: object) -> str:
        return spoken(template, language, **values)

    return say


def facts(rows: Iterable[tuple[str, str]]) -> Facts:
    """Those rows that have a value."""
    return Facts(tuple(row for row in rows if row[1]))
