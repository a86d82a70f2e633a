"""Where the time of one command goes."""

import time

from tryon_jax.wear.stopwatch import Stopwatch


class Clock(Stopwatch):
    """A stopwatch that also knows what was spent before the command began."""

    def __init__(self) -> None:
        super().__init__()
        # One thread has read and imported modules so far.
        self.seconds["start-up"] = time.process_time()

    def __str__(self) -> str:
        """One line: each stage's seconds and their sum."""
        parts = [f"{name} {seconds:.2f}" for name, seconds in self.seconds.items()]
        return f"time     {', '.join(parts)}; in all {sum(self.seconds.values()):.2f} s"
