"""Faults in how a command ended: tracebacks, exit codes, memory, time, messages that do not help."""

import re
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.inputs import Input

MOST_MIB = 1024.0
"""Resident memory of the process, what was imported included."""
EXIT_CODES = (0, 2, 3, 4)
MOST_LINES, MOST_CHARACTERS = 12, 2000
"""Limits of a message, and of one of its lines."""

_INTERNAL = re.compile(
    r"NoneType|has no attribute|not subscriptable|unsupported operand|unexpected keyword|positional argument|Traceback"
    r"|must be real number|unhashable|not iterable|<class |object at 0x|__\w+__|\b(Type|Key|Attribute|Index)Error\b"
)
"""Text that only a programmer understands."""
_WARNING = re.compile(r"(\S+\.py):\d+: (\w*Warning)")
_OWN = re.compile(r'File "[^"]*?((?:datagen|obpose|benchmark|assets)/[^"]+)", line (\d+)(?:,? in (\S+))?')

Verdict = tuple[str, str]
"""Fault, and a text that distinguishes it from others; two empty texts if there is none."""


def judge(
    each: Input,
    code: int | None,
    trace: str,
    output: str,
    errors: str,
    *,
    seconds: float,
    most_seconds: float,
    mib: float,
) -> Verdict:
    """Judge an ending: its exit code or traceback, what it printed on both streams, and what it took."""
    if trace:
        return "raised an exception", f"{trace.strip().splitlines()[-1][:60]} in {own_place(trace, last=True)}"
    if code not in EXIT_CODES:
        return f"exit code {code}", f"exit code {code}: {_template(errors)}"
    if mib > MOST_MIB:
        return f"needed {mib:.0f} MiB", f"memory: {_template(each.command)}"
    if seconds > most_seconds:
        return f"took {seconds:.0f} s", f"time: {_template(each.command)}"
    if found := _WARNING.search(errors):
        return f"warned in {found[1]}", f"{found[2]} in {Path(found[1]).name}"
    # Verification says what is wrong on standard output, and the benchmark shows failed rows there as well.
    return _judge_message(errors.strip() or output.strip(), _names(each)) if code else ("", "")


def _judge_message(message: str, names: Sequence[str]) -> Verdict:
    lines = message.splitlines()
    if not lines:
        return "failed without a message", "no message"
    longest = max(map(len, lines))
    if found := _INTERNAL.search(message):
        return f"said {found[0]!r}", f"said {found[0]!r}: {_template(lines[-1])}"
    if len(lines) > MOST_LINES or longest > MOST_CHARACTERS:
        return f"said {len(lines)} lines of up to {longest} characters", f"long: {_template(lines[0])}"
    if not any(name in " ".join(message.split()) for name in names):
        return "did not name the file", f"unnamed: {_template(lines[-1])}"
    return "", ""


def _names(each: Input) -> list[str]:
    """Names of the file in messages: its own, or that of the dataset, model or scene that it belongs to."""
    file = Path(each.file)
    folders = [f"w/{folder}" for folder in file.parents[:-1]]
    return [file.name, file.stem, *folders, f"{file.parts[0]},", *each.called]


def _template(line: str) -> str:
    """A message without its names and numbers."""
    return re.sub(r"/\S+|\d+|'[^']*'", "#", line)[:110]


def own_place(trace: str, *, last: bool) -> str:
    """Last or first file of ours in a traceback; those of `faulthandler` begin with the innermost."""
    found = _OWN.findall(trace)
    if not found:
        return "no file of ours"
    path, line, name = found[-1 if last else 0]
    return f"{path}:{line} {name}"
