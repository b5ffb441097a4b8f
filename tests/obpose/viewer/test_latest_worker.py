import threading
from collections.abc import Iterator

import pytest

from obpose.viewer.latest_worker import LatestWorker


class Recorder:
    """Makes the chunks (request, 0) to (request, 2); each but the first waits for `go`."""

    def __init__(self):
        self.delivered, self.errors = [], []
        self.began, self.go = threading.Event(), threading.Event()
        self.worker = LatestWorker(self.make, lambda *chunk: self.delivered.append(chunk), self.errors.append)

    def make(self, _request: str) -> Iterator[int]:
        for chunk in range(3):
            yield chunk
            self.began.set()
            assert self.go.wait(10)


@pytest.fixture
def recorder() -> Iterator[Recorder]:
    found = Recorder()
    yield found
    found.go.set()
    found.worker.close()


def test_all_chunks_of_a_single_request_are_made(recorder: Recorder):
    recorder.go.set()
    recorder.worker.request("a")
    assert recorder.worker.wait(10.0)
    assert recorder.delivered == [("a", 0), ("a", 1), ("a", 2)]


def test_only_the_latest_of_many_requests_is_served(recorder: Recorder):
    recorder.worker.request("a")
    assert recorder.began.wait(10)
    for request in "bcd":
        recorder.worker.request(request)
    recorder.go.set()
    assert recorder.worker.wait(10.0)
    assert recorder.delivered == [("a", 0), ("a", 1), ("d", 0), ("d", 1), ("d", 2)]


def test_jobs_run_between_two_chunks_and_are_never_cancelled(recorder: Recorder):
    recorder.worker.request("a")
    assert recorder.began.wait(10)
    for job in "xyz":
        recorder.worker.run(lambda job=job: recorder.delivered.append((job, 0)))
    recorder.go.set()
    assert recorder.worker.wait(10.0)
    assert [name for name, _ in recorder.delivered] == ["a", "a", "x", "y", "z", "a"]


def test_an_error_is_reported_and_the_next_request_is_served(recorder: Recorder):
    def fail() -> None:
        raise ValueError("no")

    recorder.go.set()
    recorder.worker.run(fail)
    recorder.worker.request("a")
    assert recorder.worker.wait(10.0)
    assert [str(error) for error in recorder.errors] == ["no"]
    assert len(recorder.delivered) == 3


def test_a_request_ends_with_its_first_error():
    delivered, errors = [], []

    def deliver(_request: str, chunk: int) -> None:
        delivered.append(chunk)
        if chunk == 2:
            raise ValueError("no")

    worker = LatestWorker(lambda _: iter((1, 2, 3)), deliver, errors.append)
    worker.request("a")
    assert worker.wait(10.0)
    worker.close()
    assert (delivered, len(errors)) == ([1, 2], 1)


def test_closing_ends_the_thread_during_a_request():
    recorder = Recorder()
    recorder.worker.request("a")
    assert recorder.began.wait(10)
    recorder.go.set()
    recorder.worker.close()
    assert not any(thread.name == "latest-worker" and thread.is_alive() for thread in threading.enumerate())
