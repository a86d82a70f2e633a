"""A thread that works on the latest request only."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Task = TypeVar("Task")


class Latest(Generic[Task]):
    """Calls `work` with one task after another; of tasks that come in meanwhile only the last is kept."""

    def __init__(self, work: Callable[[Task], None], failed: Callable[[Exception], None]) -> None:
        self._work = work
        self._failed = failed
        self._waiting: list[Task] = []
        self._closed = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def give(self, task: Task) -> None:
        """Ask for `task` in place of one that has not begun."""
        with self._news:
            self._waiting = [task]
            self._news.notify()

    def close(self) -> None:
        """End after the task that has begun."""
        with self._news:
            self._closed = True
            self._news.notify()

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                task = self._waiting.pop()
            try:
                self._work(task)
            except Exception as error:  # What goes wrong with one task must not end the thread.
                self._failed(error)
