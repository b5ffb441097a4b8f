"""The process that a job runs in: `python -m benchmark.execution.worker`, with the job on standard input.

What it has to say goes to standard output as JSON, one event a line; what the model prints goes to standard error.
"""

import json
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmark.execution.isolation import SAVING_SECONDS
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, Busy, DatagenError

_PARENT_CHECK_SECONDS = 0.5
_WORST_SCORE = "1000"


def main() -> int:
    """Run one job."""
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    parent, job = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _be_killed_first()

    def tell(**event: Any) -> None:
        with suppress(BrokenPipeError):  # the parent may be gone, which is no failure of the job
            events.write(json.dumps(event) + "\n")

    try:
        job.run(lambda done: tell(done=done))
    except MemoryError as error:
        tell(failed=f"out of memory: {error}")
    except Busy as error:
        tell(busy=str(error))
    except DatagenError as error:
        tell(failed=str(error))
    except Exception as error:  # A model may raise anything; it becomes the reason of a failed row.
        traceback.print_exc()
        tell(failed=f"{type(error).__name__}: {error}".strip().splitlines()[0])
    except SystemExit:  # A model may call sys.exit; the exit code becomes the reason, and the log says where.
        traceback.print_exc()
        raise
    else:
        return EXIT_OK
    finally:
        if os.getppid() != parent:
            _end_all()
    return EXIT_INCOMPLETE


def _end_with(parent: int) -> None:
    """End when the parent is gone, even if it was killed, after a moment in which a model may save how far it is."""
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_SECONDS)
    if signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(SAVING_SECONDS)
    _end_all()


def _end_all() -> None:
    """End this process and all that the model has started: they form a process group."""
    os.killpg(os.getpid(), signal.SIGKILL)


def _be_killed_first() -> None:
    """If memory runs out, Linux is to kill this process and not the one that waits for it."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_WORST_SCORE)


if __name__ == "__main__":
    sys.exit(main())
