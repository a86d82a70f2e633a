"""Where the time goes: named stages of one command, in order."""

import time
from collections.abc import Iterator
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

    def __str__(self) -> str:
        """One line: each stage's seconds and their sum."""
        parts = [f"{name} {seconds:.2f}" for name, seconds in self.stages.items()]
        return f"time     {', '.join(parts)}; in all {sum(self.stages.values()):.2f} s"
