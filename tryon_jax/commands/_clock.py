"""Where the time of one command goes."""

import sys
import time
from collections.abc import Callable

import numpy as np

from tryon_jax.wear.stopwatch import Stopwatch


class Clock(Stopwatch):
    """A stopwatch that also knows what was spent before the command began."""

    def __init__(self) -> None:
        super().__init__()
        # One thread has read and imported modules so far.
        self.seconds["start-up"] = time.process_time()

    def progress(self, name: str) -> Callable[[int, float, np.ndarray], None]:
        """Tells steps and residual of a simulation on the terminal, where there is one, in one line."""
        start = time.perf_counter()

        def tell(steps: int, residual: float, _: np.ndarray) -> None:
            if sys.stderr.isatty():
                seconds = time.perf_counter() - start
                line = f"{name}: {steps} steps, residual {residual:.3f}, {seconds:.0f} s"
                print(f"{line:<72}", end="\r", file=sys.stderr, flush=True)

        return tell

    def stances(self, name: str) -> Callable[[float, float, np.ndarray], None]:
        """Tells on the terminal, where there is one, how far the arms have come down, in one line."""

        def tell(degrees: float, residual: float, _: np.ndarray) -> None:
            if sys.stderr.isatty():
                line = f"{name}: {degrees:.1f} degrees, residual {residual:.3f}"
                print(f"{line:<72}", end="\r", file=sys.stderr, flush=True)

        return tell

    def counter(self, name: str) -> Callable[[int, int], None]:
        """Tells how many of how many are done on the terminal, where there is one, in one line."""

        def tell(done: int, total: int) -> None:
            if sys.stderr.isatty():
                print(f"{f'{name}: {done} of {total}':<72}", end="\r", file=sys.stderr, flush=True)

        return tell

    def __str__(self) -> str:
        """One line: each stage's seconds and their sum."""
        parts = [f"{name} {seconds:.2f}" for name, seconds in self.seconds.items()]
        return f"time     {', '.join(parts)}; in all {sum(self.seconds.values()):.2f} s"
