"""Run commands on damaged files in forked processes that are watched for crashes, hangs and exhausted memory.

`python -m tests.fuzz.driver FOLDER GROUP COUNT SECONDS` builds the valid files of a group of `tests.fuzz.worlds` and
writes to FOLDER/endings.jsonl how that many inputs ended. All is imported once, before a process is forked for many
inputs; another one takes over when an input ends it.
"""

import contextlib
import ctypes
import faulthandler
import gc
import json
import os
import re
import select
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.fuzz.commands import run_command
from tests.fuzz.inputs import Ending, Input
from tests.fuzz.judging import MOST_MIB, judge, own_place
from tests.fuzz.mutations import mutate

_POLL_SECONDS = 0.02
_LINKED_BYTES = 2**17
"""Larger files of a world that stay as they are get a second name in the place of a copy."""


def run_inputs(inputs: Sequence[Input], scratch: Path, most_seconds: float) -> Iterator[Ending]:
    """Run every input, and give how each ended, in their order."""
    done = 0
    while done < len(inputs):
        for ending in _run_some(inputs[done:], scratch, most_seconds):
            done += 1
            yield ending


def _run_some(inputs: Sequence[Input], scratch: Path, most_seconds: float) -> Iterator[Ending]:
    """Run inputs in one process until one of them ends it."""
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    reader, writer = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if not child:
        os.close(reader)
        try:
            _be_child(inputs, scratch, writer, most_seconds)
        finally:
            os._exit(0)
    with contextlib.suppress(OSError):  # the child does the same, whoever is first
        os.setpgid(child, child)
    os.close(writer)
    try:
        yield from _watch(child, inputs, reader, scratch, most_seconds)
    finally:
        os.close(reader)


def _watch(child: int, inputs: Sequence[Input], pipe: int, scratch: Path, most_seconds: float) -> Iterator[Ending]:
    """Hear how inputs end; give up on the first that ends the process, or that has to be stopped."""
    heard, started, most_mib = b"", time.monotonic(), 0.0
    for each in inputs:
        verdict = ""
        while b"\n" not in heard and not verdict:
            if select.select([pipe], [], [], _POLL_SECONDS)[0]:
                read = os.read(pipe, 2**16)
                heard += read
                verdict = "" if read else "ended"
            most_mib = max(most_mib, _resident_mib(child))
            if most_mib > MOST_MIB:
                verdict = f"needed more than {MOST_MIB:g} MiB"
            elif time.monotonic() - started > most_seconds + 1:
                verdict = f"took more than {most_seconds:g} s"
        if verdict:
            yield _broken(each, verdict, _end(child), time.monotonic() - started, most_mib, scratch)
            return
        line, heard = heard.split(b"\n", 1)
        yield Ending(**json.loads(line))
        started, most_mib = time.monotonic(), 0.0
    _end(child)


def _end(child: int) -> int:
    """End a process and all that it started; its exit code, or the signal that ended it as a negative number."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _broken(each: Input, verdict: str, code: int, seconds: float, mib: float, scratch: Path) -> Ending:
    """The ending of an input that the process did not survive."""
    if verdict == "ended":
        verdict = f"killed by {signal.Signals(-code).name}" if code < 0 else f"left the process with code {code}"
    change, output, errors = (_text(scratch / name) for name in ("change", "output", "errors"))
    place = f"{verdict} {own_place(errors, last=False)}"
    return Ending(each.file, each.seed, each.command, change, verdict, place, None, output + errors, seconds, mib)


def _be_child(inputs: Sequence[Input], scratch: Path, pipe: int, most_seconds: float) -> None:
    """Run inputs one after the other, a line of JSON for each, and leave."""
    os.setpgid(0, 0)
    with (scratch / "output").open("w+b") as output, (scratch / "errors").open("w+b") as errors:
        os.dup2(output.fileno(), 1)
        os.dup2(errors.fileno(), 2)
        faulthandler.enable(2)
        for number, each in enumerate(inputs):
            for file in (output, errors):
                file.seek(0)
                file.truncate()
            ending = _run_one(each, scratch / str(number), scratch, most_seconds)
            os.write(pipe, (json.dumps(asdict(ending)) + "\n").encode())
            shutil.rmtree(scratch / str(number), ignore_errors=True)


def _run_one(each: Input, folder: Path, scratch: Path, most_seconds: float) -> Ending:
    try:
        change = _copy_and_damage(each, folder / "w")
    except BaseException:  # a fault of the test itself, which must not pass for one of the command
        failure = traceback.format_exc()
        return Ending(each.file, each.seed, each.command, "", "DAMAGING FAILED", failure, None, failure, 0.0, 0.0)
    (scratch / "change").write_text(change)
    _forget_peak()
    faulthandler.dump_traceback_later(most_seconds, file=2)
    began = time.monotonic()
    code, trace = run_command(each.command.format(w=folder / "w", o=folder / "new").split(" "))
    seconds, mib = time.monotonic() - began, _peak_mib()
    faulthandler.cancel_dump_traceback_later()
    sys.stdout.flush()
    sys.stderr.flush()
    output, errors = _text(scratch / "output"), _text(scratch / "errors")
    fault, place = judge(each, code, trace, output, errors, seconds=seconds, most_seconds=most_seconds, mib=mib)
    shown = (output + errors + trace).replace(str(folder), "")
    return Ending(each.file, each.seed, each.command, change, fault, place, code, shown, seconds, mib)


def _copy_and_damage(each: Input, world: Path) -> str:
    victim = each.world / each.file

    def copy(source: str, target: str) -> str:
        if Path(source) != victim and os.stat(source).st_size > _LINKED_BYTES and not source.endswith(".h5"):
            os.link(source, target)
            return target
        return shutil.copyfile(source, target)

    shutil.copytree(each.world, world, copy_function=copy)
    with warnings.catch_warnings(action="ignore"):
        return mutate(world / each.file, np.random.default_rng(each.seed))


def _resident_mib(process: int) -> float:
    """Memory that a process has now; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20
    except (OSError, IndexError):
        return 0.0


def _peak_mib() -> float:
    """Largest resident memory of this process since `_forget_peak`."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) / 1024 if found else 0.0


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _let_go_of_memory() -> None:
    """Give back what the valid files took, so that forked processes have about the memory of a fresh command."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def main() -> None:
    """Build, run and record."""
    from tests.fuzz.worlds import GROUPS
    from tests.fuzz.worlds.group import inputs_of, run_undamaged

    folder, group = Path(sys.argv[1]).resolve(), GROUPS[sys.argv[2]]
    os.environ.update(OBPOSE_CACHE=str(folder / "cache"), HOME=str(folder), COLUMNS="1000")
    world = folder / "world"
    group.build(world)
    run_undamaged(group, world, folder / "once")
    _let_go_of_memory()
    with (folder / "endings.jsonl").open("w") as file:
        for ending in run_inputs(inputs_of(group, world, int(sys.argv[3])), folder / "scratch", float(sys.argv[4])):
            file.write(json.dumps(asdict(ending)) + "\n")
            file.flush()


if __name__ == "__main__":
    main()
