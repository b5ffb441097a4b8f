"""Bad endings of commands."""

from pathlib import Path

import pytest

from tests.fuzz.inputs import Input
from tests.fuzz.judging import judge

INPUT = Input(Path("world"), "data/train-00000.h5", 0, "load {w}/data")
PLAIN = "load: /tmp/w/data/train-00000.h5 is damaged; make it again.\n"


def fault(
    code: int | None, errors: str, *, output: str = "", trace: str = "", mib: float = 100, seconds: float = 1
) -> str:
    return judge(INPUT, code, trace, output, errors, seconds=seconds, most_seconds=20, mib=mib)[0]


@pytest.mark.parametrize("code", [0, 2, 3, 4])
def test_a_plain_message_is_well(code: int):
    assert fault(code, PLAIN) == ""
    assert fault(code, "", output=PLAIN) == ""
    assert fault(code, PLAIN, output="a line\n" * 100) == ""


@pytest.mark.parametrize(
    ("expected", "code", "errors", "others"),
    [
        ("raised an exception", None, PLAIN, {"trace": "Traceback\nKeyError: 'x'"}),
        ("exit code 1", 1, PLAIN, {}),
        ("exit code 130", 130, PLAIN, {}),
        ("needed 1025 MiB", 3, PLAIN, {"mib": 1025}),
        ("took 21 s", 0, "", {"seconds": 21}),
        ("warned in /lib/x.py", 0, "/lib/x.py:7: RuntimeWarning: overflow", {}),
        ("failed without a message", 2, " \n", {}),
        ("said 'NoneType'", 3, f"{PLAIN} NoneType", {}),
        ("said 'object at 0x'", 3, f"{PLAIN} <ast.Name object at 0x7f>", {}),
        ("said 13 lines of up to 59 characters", 3, PLAIN * 13, {}),
        ("said 1 lines of up to 2059 characters", 3, PLAIN.strip() + "x" * 2000, {}),
        ("did not name the file", 3, "load: A file is damaged.", {}),
    ],
)
def test_what_is_not(expected: str, code: int | None, errors: str, others: dict[str, object]):
    assert fault(code, errors, **others).startswith(expected)  # type: ignore[arg-type]
