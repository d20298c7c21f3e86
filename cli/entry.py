"""The console script. Loading the commands takes a moment, and Ctrl-C in it ends as quietly as later."""

import sys

EXIT_INTERRUPTED = 130


def run() -> None:
    """Load the command line and run it; ends the process with its exit code."""
    try:
        from cli.main import run as run_command

        run_command()
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
