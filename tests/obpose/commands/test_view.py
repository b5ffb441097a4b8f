import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest

from datagen.errors import EXIT_INTERRUPTED, EXIT_USAGE
from obpose.commands.view import Arguments, check, main
from obpose.errors import UsageError
from tests.obpose.viewer.driving import free_port

MODEL = "obpose--moving--64x64"


def test_it_serves_until_ctrl_c_and_ends_with_one_line(tiny_dataset: Path, tmp_path: Path):
    port = free_port()
    flags = ["--port", str(port), "--out", str(tmp_path)]
    command = [sys.executable, "-m", "obpose.commands.view", str(tiny_dataset), *flags]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert f"http://127.0.0.1:{port} shows moving, test 0; Ctrl-C ends it." in process.stdout.readline()
        with urlopen(f"http://127.0.0.1:{port}") as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=120)
    assert process.returncode == EXIT_INTERRUPTED
    assert errors == "obpose-view: Closed; unsaved edits are lost.\n"
    assert output == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: no such folder; expected a dataset"),
        (["EMPTY"], "holds no dataset"),
        (["DATA", "--checkpoint", "none"], "--checkpoint none: no such folder"),
        (["DATA", "--scene", "2"], "--scene 2: expected 0 to 1"),
        (["DATA", "--scene", "-1"], "--scene -1: expected 0 or more"),
        (["DATA", "--port", "0"], "--port 0: expected 1 to 65535"),
        (["DATA", "--port", "70000"], "--port 70000: expected 1 to 65535"),
        (["DATA", "--port", "-1"], "--port -1: expected 1 to 65535"),
        ([""], "Argument 1 is empty; expected a value"),
        (["DATA", "--out", ""], "--out is empty; expected a value"),
        (["DATA", "--out="], "--out is empty; expected a value"),
        (["DATA", "--checkpoint", ""], "--checkpoint is empty; expected a value"),
        (["DATA", "--data", ""], "--data is empty; expected a value"),
        (["DATA", "--host", ""], "--host is empty; expected a value"),
        (["DATA", "--data", "DATA"], "is a dataset itself; leave out --data"),
        (["DATA", "--host", "no.such.host.invalid"], "Cannot listen at no.such.host.invalid"),
        (["DATA", "--host", "a..b"], ": it is no name of a host; give another --port or --host"),
        (["DATA", "--out", "EMPTY/file"], "is a file; expected a folder"),
        ([MODEL], "say with --data DIR"),
    ],
)
def test_bad_input_is_one_line(tiny_dataset: Path, tmp_path: Path, capsys, arguments: list[str], message: str):
    (tmp_path / "file").touch()
    places = {"DATA": str(tiny_dataset), "EMPTY": str(tmp_path)}
    given = [part.replace("EMPTY", places["EMPTY"]).replace("DATA", places["DATA"]) for part in arguments]
    assert main([*given, *([] if "--port" in given else ["--port", str(free_port())])]) == EXIT_USAGE
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1


def test_a_used_port_is_reported(tmp_path: Path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main([str(tmp_path), "--port", str(port)]) == EXIT_USAGE
    assert f"Cannot listen at 127.0.0.1, port {port}" in capsys.readouterr().err


def test_without_viser_it_says_how_to_install_it(tmp_path: Path):
    with pytest.raises(UsageError, match=r"pip install 'obpose\[view\]'"):
        check(Arguments(tmp_path), has_viser=False)
