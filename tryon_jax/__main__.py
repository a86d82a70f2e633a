"""`python -m tryon_jax`: the same as `tryon`, where scripts are not on the path."""

import sys

from tryon_jax.cli import main

if __name__ == "__main__":
    sys.exit(main())
