"""The process of a worker of `datagen.pipeline.parallel`: `python -m datagen.pipeline.worker SOCKET PARENT`."""

import signal
import sys
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection

from datagen.console import interrupts


def main(socket: int, parent: int) -> None:
    """Receive a function over the socket, then arguments; send its result, or nothing and what it raised.

    Ctrl-C is left to the parent. The process ends with its parent, even if that is killed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    interrupts.end_with(parent)
    connection = Connection(socket)
    with suppress(EOFError, ConnectionError):  # the parent has ended
        make = connection.recv()
        while True:
            scene = connection.recv()
            try:
                answer = make(*scene), None
            except Exception as error:  # whatever it is, the parent raises it
                error.add_note(f"It was raised in a worker process:\n{traceback.format_exc()}")
                answer = None, error
            connection.send(answer)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
