"""What is kept, what is dropped, and what is computed once."""

import threading
import time

from tryon_jax.wear.last_used import LastUsed


def test_the_longest_unused_value_is_dropped():
    made = []

    def make(key):
        made.append(key)
        return key.upper()

    kept = LastUsed(2)
    assert [kept.get(key, lambda key=key: make(key)) for key in "abab"] == ["A", "B", "A", "B"]
    assert made == ["a", "b"]
    # b was used last: c takes the place of a.
    kept.get("c", lambda: make("c"))
    kept.get("b", lambda: make("b"))
    assert made == ["a", "b", "c"]
    kept.get("a", lambda: make("a"))
    assert made == ["a", "b", "c", "a"]


def test_threads_that_ask_for_the_same_compute_it_once():
    made = []

    def make():
        made.append(None)
        time.sleep(0.02)
        return 1

    kept = LastUsed(2)
    threads = [threading.Thread(target=kept.get, args=("key", make)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
