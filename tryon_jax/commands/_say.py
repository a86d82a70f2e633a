"""Printing; a closed output does not stop the work."""

import os
import sys


def say(*lines: object) -> None:
    """Print lines at once. Where the output is closed they are dropped, and the files are still written."""
    try:
        for line in lines:
            print(line, flush=True)
    except BrokenPipeError:
        # Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
