import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import dataclass

import pytest

from datagen.errors import DatagenError, UsageError
from datagen.pipeline.parallel import make_all
from datagen.storage.shard import PackedScene
from tests.paths import ROOT
from tests.processes import command_line, descendants, errors_at_end, wait_until

SCENES = [("train", index) for index in range(12)]


@dataclass(frozen=True)
class Maker:
    """Scenes whose hash says which they are and where they were made; some take longer, one is fatal."""

    fatal: int = -1
    wrong: int = -1

    def __call__(self, split: str, index: int) -> PackedScene:
        if index == self.fatal:
            os._exit(9)
        if index == self.wrong:
            raise UsageError(f"scene {index} is impossible")
        time.sleep(0.02 * (index % 3))
        return PackedScene({}, {}, f"{split} {index} {os.getpid()}")


def places(scenes) -> list[str]:
    return [scene.hash.rpartition(" ")[0] for scene in scenes]


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_scenes_come_in_their_order(workers: int):
    assert places(make_all(Maker(), SCENES, workers)) == [f"train {index}" for index in range(12)]


def handler_of_interrupts(split: str, index: int) -> PackedScene:
    return PackedScene({}, {}, f"{os.getpid()} {signal.getsignal(signal.SIGINT) == signal.SIG_IGN}")


def test_workers_leave_interrupts_to_the_parent():
    made = [scene.hash.split() for scene in make_all(handler_of_interrupts, SCENES, 2)]
    assert {ignored == "True" for process, ignored in made if process != str(os.getpid())} == {True}
    in_parent = {ignored == "True" for process, ignored in made if process == str(os.getpid())}
    assert in_parent == {signal.getsignal(signal.SIGINT) == signal.SIG_IGN}


def test_two_workers_both_work():
    processes = {scene.hash.rpartition(" ")[2] for scene in make_all(Maker(), SCENES, 2)}
    assert len(processes - {str(os.getpid())}) == 2


@pytest.mark.parametrize("scenes", [[], SCENES[:1], SCENES[:2]])
def test_few_scenes_need_no_workers(scenes):
    made = list(make_all(Maker(), scenes, 2))
    assert {scene.hash.rpartition(" ")[2] for scene in made} <= {str(os.getpid())}
    assert len(made) == len(scenes)


@pytest.mark.parametrize(("workers", "least"), [(1, 5), (2, 1)])
def test_what_is_wrong_with_a_scene_is_told_instead_of_it(workers: int, least: int):
    made = []
    with pytest.raises(UsageError, match="scene 5 is impossible"):
        made.extend(make_all(Maker(wrong=5), SCENES, workers))
    # Several processes tell it at once, even if scenes before it are not finished.
    assert least <= len(made) <= 5
    assert places(made) == [f"train {index}" for index in range(len(made))]


def test_errors_name_the_line_of_the_worker():
    with pytest.raises(UsageError) as raised:
        list(make_all(Maker(wrong=5), SCENES, 2))
    assert "in __call__" in raised.value.__notes__[0]


def test_a_worker_that_dies_is_one_clear_error_and_the_next_run_works():
    with pytest.raises(DatagenError, match=r"worker process died.*same command again"):
        list(make_all(Maker(fatal=7), SCENES, 2))
    assert len(list(make_all(Maker(), SCENES, 2))) == 12


class DiesSoon:
    """Ends the process of whoever pickles it, a moment later."""

    def __reduce__(self):
        threading.Timer(0.05, os._exit, (9,)).start()
        return DiesSoon, ()


def send_and_die(split: str, index: int) -> object:
    """Give a scene that takes some tenths of a second to send, once it is pickled."""
    return (bytes(300_000_000), DiesSoon()) if index == 7 else index


def test_a_worker_that_dies_while_it_sends_is_noticed_too():
    """If workers shared a pipe, the other one would keep it open, and the parent would wait forever."""
    with pytest.raises(DatagenError, match="worker process died"):
        list(make_all(send_and_die, SCENES, 2))


def test_whoever_needs_no_more_scenes_may_stop():
    with closing(make_all(Maker(), SCENES, 2)) as scenes:
        assert places([next(scenes), next(scenes)]) == ["train 0", "train 1"]


PARENT = """
import functools, os, signal
from datagen.pipeline.parallel import make_all

class Maker:
    def __call__(self, number, divisor):
        return divmod(number, divisor)

    def __reduce__(self):  # called when it is sent to a worker that has been started
        {when_sent}

list(make_all(Maker(), [(index, 1) for index in range(4)], 2))
"""


def start_parent(when_sent: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", PARENT.format(when_sent=when_sent)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def test_workers_whose_parent_was_killed_before_it_sent_a_task_do_not_outlive_it():
    parent = start_parent("os.kill(os.getpid(), signal.SIGKILL)")
    errors_at_end(parent)
    assert parent.returncode == -signal.SIGKILL


@pytest.mark.slow
@pytest.mark.parametrize("milliseconds", [0, 2, 5, 10, 20, 40, 100, 200, 400])
def test_workers_whose_parent_was_killed_while_it_started_them_do_not_outlive_it(milliseconds: int):
    parent = start_parent("return functools.partial, (divmod,)")
    wait_until(
        lambda: any(b"pipeline.worker" in command_line(child) for child in descendants(parent.pid)),
        what="the first worker",
    )
    time.sleep(milliseconds / 1000)
    parent.kill()
    errors_at_end(parent)
