"""The process of one job: `python -m benchmark.execution.worker`, with the pickled job on standard input.

Events are written to standard output as JSON, one per line. Output of the model goes to standard error.
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

from benchmark.execution.executor import SAVING_SECONDS
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, Busy, DatagenError

_PARENT_CHECK_SECONDS = 0.5
_WORST_SCORE = "1000"


def main() -> int:
    """Run one job."""
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    parent, job = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()
    _prefer_as_oom_victim()

    def send(**event: Any) -> None:
        with suppress(BrokenPipeError):  # a missing parent is not a failure of the job
            events.write(json.dumps(event) + "\n")

    try:
        job.run(lambda done: send(done=done))
    except MemoryError as error:
        send(failed=f"out of memory: {error}")
    except Busy as error:
        send(busy=str(error))
    except DatagenError as error:
        send(failed=str(error))
    except Exception as error:  # A model may raise anything; the message becomes the reason of the failed row.
        traceback.print_exc()
        send(failed=f"{type(error).__name__}: {error}".strip().splitlines()[0])
    except SystemExit:  # A model may call sys.exit; the exit code becomes the reason, and the log says where.
        traceback.print_exc()
        raise
    else:
        return EXIT_OK
    finally:
        if os.getppid() != parent:
            _kill_group()
    return EXIT_INCOMPLETE


def _exit_with_parent(parent: int) -> None:
    """Exit when the parent is gone, even if it was killed, after a grace period in which a model may save its state."""
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_SECONDS)
    if signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(SAVING_SECONDS)
    _kill_group()


def _kill_group() -> None:
    """Kill this process and all processes that the model has started; they form a process group."""
    os.killpg(os.getpid(), signal.SIGKILL)


def _prefer_as_oom_victim() -> None:
    """Let Linux kill this process, and not its parent, if memory runs out."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_WORST_SCORE)


if __name__ == "__main__":
    sys.exit(main())
