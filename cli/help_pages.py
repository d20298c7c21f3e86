"""Help pages in the chosen language: the words that typer itself puts on them, and lines of Chinese."""

from typing import Any

import typer.core
import typer.rich_utils
from rich.columns import Columns
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from protocol.language import say


class Command(typer.core.TyperCommand):
    """A command whose `--help` explains itself in the chosen language."""

    def get_help_option(self, *args: Any, **named: Any) -> Any:
        return _explained(super().get_help_option(*args, **named))


class Group(typer.core.TyperGroup):
    """A group of commands whose `--help` explains itself in the chosen language."""

    def get_help_option(self, *args: Any, **named: Any) -> Any:
        return _explained(super().get_help_option(*args, **named))


class _FoldedTable(Table):
    """Breaks a line where it is full: Chinese has no spaces, and what does not fit would be cut off."""

    def add_row(self, *cells: Any, **named: Any) -> None:
        super().add_row(*cells, **named)
        for column in self.columns:
            column.overflow = "fold"


def speak_on_help_pages() -> None:
    """Give typer's help pages their titles and remarks in the chosen language."""
    pages = typer.rich_utils
    pages.OPTIONS_PANEL_TITLE = say("Options")
    pages.ARGUMENTS_PANEL_TITLE = say("Arguments")
    pages.COMMANDS_PANEL_TITLE = say("Commands")
    pages.ERRORS_PANEL_TITLE = say("Error")
    pages.DEFAULT_STRING = say("[default: {}]")
    pages.ENVVAR_STRING = say("[env var: {}]")
    pages.REQUIRED_LONG_STRING = say("[required]")
    pages.RICH_HELP = say("Try [blue]'{command_path} {help_option}'[/] for help.")
    setattr(pages, "Table", _FoldedTable)  # noqa: B010 - typer has no setting for it
    setattr(pages, "Columns", _in_a_row)  # noqa: B010


def _in_a_row(items: list[RenderableType]) -> RenderableType:
    """An option's explanation and its remarks, as one text that is broken where the line is full."""
    texts = [item for item in items if isinstance(item, Text)]
    if len(texts) < len(items):
        return Columns(items)
    joined = Text(" ").join(texts)
    joined.overflow = "fold"
    return joined


def _explained(option: Any) -> Any:
    if option is not None:
        option.help = say("Show this message and exit.")
    return option
