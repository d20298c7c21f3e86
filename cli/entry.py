"""The console script. Loading the commands takes a moment, and Ctrl-C in it ends as quietly as later."""

import os
import sys

EXIT_INTERRUPTED = 130


def run() -> None:
    """Load the command line and run it; ends the process with its exit code."""
    # before numpy: a line is a dozen processes on a few cores, and threads of small products only wait
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from cli.main import run as run_command

        run_command()
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
