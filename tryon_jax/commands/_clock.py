"""Where the time goes: named stages of one command, in order."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Clock:
    """Adds up wall-clock seconds by stage."""

    def __init__(self) -> None:
        # What was spent before the command began is start-up: one thread that reads and imports modules.
        self.stages: dict[str, float] = {"start-up": time.process_time()}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the block under `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.perf_counter() - start

    def progress(self, name: str) -> Callable[[int, float], None]:
        """Tells steps and residual of a simulation on the terminal, where there is one, in one line."""
        start = time.perf_counter()

        def tell(steps: int, residual: float) -> None:
            if sys.stderr.isatty():
                seconds = time.perf_counter() - start
                line = f"\r{name}: {steps} steps, residual {residual:.3f}, {seconds:.0f} s"
                print(f"{line:<72}", end="\r", file=sys.stderr, flush=True)

        return tell

    def __str__(self) -> str:
        """One line: each stage's seconds and their sum."""
        parts = [f"{name} {seconds:.2f}" for name, seconds in self.stages.items()]
        return f"time     {', '.join(parts)}; in all {sum(self.stages.values()):.2f} s"
