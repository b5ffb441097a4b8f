import threading
from collections.abc import Iterator

import pytest

from obpose.viewer.latest_worker import Newest


class Recorder:
    """Pieces (wish, 0), (wish, 1), ...; each but the first waits until it is let go."""

    def __init__(self, pieces: int = 3):
        self.pieces, self.delivered, self.errors = pieces, [], []
        self.began, self.go = threading.Event(), threading.Event()
        self.work = Newest(self.make, lambda wish, piece: self.delivered.append((wish, piece)), self.errors.append)

    def make(self, wish: str) -> Iterator[int]:
        for piece in range(self.pieces):
            yield piece
            self.began.set()
            assert self.go.wait(10)


@pytest.fixture
def recorder() -> Iterator[Recorder]:
    found = Recorder()
    yield found
    found.go.set()
    found.work.close()


def test_all_pieces_of_the_only_wish_are_made(recorder: Recorder):
    recorder.go.set()
    recorder.work.wish("a")
    assert recorder.work.wait(10.0)
    assert recorder.delivered == [("a", 0), ("a", 1), ("a", 2)]


def test_of_many_wishes_the_newest_is_worked_on_and_the_others_are_dropped(recorder: Recorder):
    recorder.work.wish("a")
    assert recorder.began.wait(10)
    for wish in "bcd":
        recorder.work.wish(wish)
    recorder.go.set()
    assert recorder.work.wait(10.0)
    assert recorder.delivered == [("a", 0), ("a", 1), ("d", 0), ("d", 1), ("d", 2)]


def test_jobs_run_between_two_pieces_and_are_never_dropped(recorder: Recorder):
    recorder.work.wish("a")
    assert recorder.began.wait(10)
    for job in "xyz":
        recorder.work.run(lambda job=job: recorder.delivered.append((job, 0)))
    recorder.go.set()
    assert recorder.work.wait(10.0)
    assert [wish for wish, _ in recorder.delivered] == ["a", "a", "x", "y", "z", "a"]


def test_what_fails_is_told_and_the_next_is_done(recorder: Recorder):
    def fail() -> None:
        raise ValueError("no")

    recorder.go.set()
    recorder.work.run(fail)
    recorder.work.wish("a")
    assert recorder.work.wait(10.0)
    assert [str(error) for error in recorder.errors] == ["no"]
    assert len(recorder.delivered) == 3


def test_it_ends_while_something_is_half_done():
    recorder = Recorder()
    recorder.work.wish("a")
    assert recorder.began.wait(10)
    recorder.go.set()
    recorder.work.close()
    assert not any(thread.name == "newest" and thread.is_alive() for thread in threading.enumerate())
