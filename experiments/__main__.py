"""`python -m experiments NAME [options]`."""

import sys

from tryon_jax.cli import dispatch

if __name__ == "__main__":
    sys.exit(dispatch("python -m experiments", "experiments"))
