"""The driver finds out every way in which a command can misbehave, and goes on with the next input."""

import pytest

from tests.fuzz.inputs import Ending
from tests.fuzz.running import endings_of

FOUND = {
    "raise": "raised an exception",
    "allocate": "needed more than 1024 MiB",
    "sleep": "took more than 5 s",
    "kill": "killed by SIGSEGV",
    "leave": "left the process with code 0",
    "exit": "exit code 1",
    "silent": "failed without a message",
    "internal": "said 'NoneType'",
    "unnamed": "did not name the file",
    "long": "said 100 lines",
    "warn": "warned in /lib/image.py",
    "well": "",
}


@pytest.fixture(scope="module")
def endings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ending]:
    found = endings_of(tmp_path_factory.mktemp("driver"), "misbehaving", 12, seconds=5)
    return {ending.command.split(" ")[1]: ending for ending in found}


@pytest.mark.parametrize("what", FOUND)
def test_misbehaviour_is_found(endings: dict[str, Ending], what: str):
    fault = endings[what].fault
    assert fault.startswith(FOUND[what])
    assert bool(fault) == bool(FOUND[what])


def test_where_it_happened_is_told(endings: dict[str, Ending]):
    assert "KeyError" in endings["raise"].place
    assert "threading.py" in endings["sleep"].output
    assert all(ending.change for ending in endings.values())
