import threading

from tryon_jax.viewer.latest import Latest


def test_only_the_latest_of_waiting_tasks_is_done_and_errors_end_nothing():
    begun, go_on, ended = threading.Event(), threading.Event(), threading.Event()
    done: list[int] = []
    errors: list[str] = []

    def work(task: int) -> None:
        if task == 0:
            begun.set()
            assert go_on.wait(5)
            raise ValueError("zero")
        done.append(task)
        ended.set()

    latest = Latest(work, lambda error: errors.append(str(error)))
    latest.give(0)
    assert begun.wait(5)
    for task in (1, 2, 3):
        latest.give(task)
    go_on.set()
    assert ended.wait(5)
    assert (done, errors) == ([3], ["zero"])
    latest.close()
    latest._thread.join(5)
    assert not latest._thread.is_alive()
