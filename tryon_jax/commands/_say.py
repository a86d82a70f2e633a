"""Lines for whoever reads; a reader who went away does not stop the work."""

import os
import sys


def say(*lines: object) -> None:
    """Print lines at once. Where nobody reads any more, they go nowhere, and the files are written all the same."""
    try:
        for line in lines:
            print(line, flush=True)
    except BrokenPipeError:
        # Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
