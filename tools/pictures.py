"""Make the pictures of the README and the documentation with the program itself: python tools/pictures.py [NAME...]"""

import sys
from pathlib import Path

from tryon_jax.cli import main as tryon

IMAGES = Path(__file__).parents[1] / "docs" / "images"
COMMANDS = {
    "drape.jpg": "drape --design dress --betas 1.5 -0.5 --fabric gray-interlock --height 640 --picture",
    "body.jpg": "body --stature 1.72 --chest 0.96 --height 560 --picture",
    "pattern.jpg": "pattern --design dress --picture",
}
"""Each picture and the command line that makes it."""


def main() -> int:
    """Make the pictures that are named, or all."""
    for name in sys.argv[1:] or COMMANDS:
        code = tryon([*COMMANDS[name].split(), str(IMAGES / name)])
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
