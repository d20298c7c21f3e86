# pyright: strict
"""HTML as a value that escapes by construction. Pure.

Whatever is not `Html` already is text and gets escaped, attributes too, so that a hostile serial
or step name cannot become markup; nobody has to remember it.
"""

from collections.abc import Iterable
from html import escape

VOID_ELEMENTS = frozenset({"input", "meta", "link", "br", "hr"})


class Html(str):
    """Text that is markup already; made by `element`, `join` and constants of this package."""

    __slots__ = ()


def element(name: str, /, *children: str, **attributes: str | float | bool | None) -> Html:
    """An HTML element. Children that are not `Html` are escaped.

    Attribute names: `class_` is `class`, an underscore inside is a hyphen (`aria_label`). None and
    False leave the attribute out, True gives it without a value.
    """
    parts = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        attribute = key.rstrip("_").replace("_", "-")
        parts.append(attribute if value is True else f'{attribute}="{escape(str(value))}"')
    opening = f"<{' '.join(parts)}>"
    if name in VOID_ELEMENTS:
        return Html(opening)
    return Html(f"{opening}{join(children)}</{name}>")


def join(children: Iterable[str]) -> Html:
    """Children one after the other; those that are not `Html` are escaped."""
    return Html("".join(child if isinstance(child, Html) else escape(child) for child in children))


def div(class_: str, /, *children: str, **attributes: str | float | bool | None) -> Html:
    """A `div` with its class, the commonest element here."""
    return element("div", *children, class_=class_, **attributes)


def span(class_: str, /, *children: str, **attributes: str | float | bool | None) -> Html:
    """A `span` with its class."""
    return element("span", *children, class_=class_, **attributes)
