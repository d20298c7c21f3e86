"""`testloom`: the entry point. Chooses the language, mounts the commands, renders errors for people."""

import importlib
import sys
import tempfile
import traceback
from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from cli.entry import EXIT_INTERRUPTED
from cli.help_pages import Command, Group, speak_on_help_pages
from cli.process_group import end_with_parent
from protocol.errors import Fault, TestloomError
from protocol.language import LANGUAGES, choose_language, say, translated

EXIT_ERROR = 1

# command → module of this package, and the function or typer app in it
COMMANDS = {
    "up": ("up_command", "up"),
    "order": ("coordinator_commands", "order"),
    "status": ("coordinator_commands", "status"),
    "unit": ("coordinator_commands", "unit"),
    "yield": ("coordinator_commands", "show_yield"),
    "recording": ("recording_commands", "app"),
    "emulator": ("emulator_commands", "app"),
    "calibrate": ("calibrate_command", "app"),
    "certificate": ("certificate_command", "certificate"),
    "gap": ("gap_commands", "app"),
    "doctor": ("doctor_command", "doctor"),
    "router": ("router_command", "router"),
    "coordinator": ("coordinator_commands", "coordinator"),
    "bench": ("bench_commands", "bench"),
    "station": ("station_commands", "station"),
    "dashboard": ("dashboard_command", "dashboard"),
}


def run() -> None:
    """The console script: runs a command and ends the process with its exit code."""
    end_with_parent()
    sys.exit(main(sys.argv[1:]))


def main(arguments: list[str]) -> int:
    """Run the command line. Returns the exit code; never raises for what a user can cause."""
    try:
        remaining = _take_language(arguments)
        return build_app(remaining)(args=remaining, prog_name="testloom", standalone_mode=True) or 0
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else EXIT_ERROR
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except TestloomError as error:
        show_error(error)
        return EXIT_ERROR
    except Exception as error:  # noqa: BLE001 - the last wall: a user gets a sentence and a file, not a traceback
        _show_unexpected(error)
        return EXIT_ERROR


def build_app(arguments: list[str]) -> typer.Typer:
    """The commands, of which only the one that `arguments` name is imported: a line starts many processes.

    Built after the language is chosen, since help texts are words for people.
    """
    speak_on_help_pages()
    app = typer.Typer(
        cls=Group,
        help=say("Production test for inertial sensors and GNC modules."),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        add_completion=False,
    )

    @app.callback()
    def options(
        lang: str = typer.Option("en", "--lang", envvar="TESTLOOM_LANG", help=say("Language: en or zh.")),
    ) -> None:
        del lang  # taken before the commands were built

    named = [argument for argument in arguments if not argument.startswith("-")][:1]
    for name in named if named and named[0] in COMMANDS else COMMANDS:
        module, attribute = COMMANDS[name]
        command = getattr(importlib.import_module(f"cli.{module}"), attribute)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name, cls=Command)(command)
    return app


def show_error(error: TestloomError) -> None:
    """Print what is wrong, where, whose fault it is and what to do, to standard error."""
    console = Console(stderr=True, highlight=False)
    console.print(Text(translated(error.what), style="bold red"), soft_wrap=True)
    for label, words in (
        (say("Where"), error.where),
        (say("Fault"), say(error.fault.value)),
        (say("What to do"), translated(error.remedy)),
        (say("Before that"), "; ".join(translated(words) for words in error.story)),
    ):
        if words:
            console.print(Text(f"  {label}: {words}"), soft_wrap=True)


def _take_language(arguments: list[str]) -> list[str]:
    """Choose the language of `--lang X` wherever it stands, and take it out of the arguments."""
    remaining: list[str] = []
    position = 0
    while position < len(arguments):
        argument = arguments[position]
        if argument == "--lang" and position + 1 < len(arguments):
            _choose(arguments[position + 1])
            position += 2
            continue
        if argument.startswith("--lang="):
            _choose(argument.removeprefix("--lang="))
        else:
            remaining.append(argument)
        position += 1
    return remaining


def _choose(language: str) -> None:
    if language not in LANGUAGES:
        raise TestloomError(
            f"The language '{language}' is not spoken here.",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(LANGUAGES)}.",
        )
    choose_language(language)


def _show_unexpected(error: Exception) -> None:
    with tempfile.NamedTemporaryFile("w", prefix="testloom-error-", suffix=".txt", delete=False) as report:
        report.write("".join(traceback.format_exception(error)))
    show_error(
        TestloomError(
            f"Something went wrong that we did not foresee ({type(error).__name__}: {error}).",
            where=str(Path(report.name)),
            remedy="send us this file.",
        )
    )


if __name__ == "__main__":
    run()
