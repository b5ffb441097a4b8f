"""The report on a folder of meshes: a row for each, errors with remedies, a sheet of thumbnails."""

import os
import signal
import subprocess
import sys
from importlib import util
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from datagen.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_VERIFICATION, UsageError
from datagen.inspect import assets_check
from datagen.inspect.assets_check import TILE, run
from datagen.meshes.survey import Reading
from tests.paths import ROOT
from tests.processes import command_line, descendants, errors_at_end, wait_until, wait_until_gone
from tests.worlds.meshes import BOX, triangles, write_obj, write_stl


def test_a_good_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path / "cache"))
    write_obj(tmp_path / "meshes")
    assert run(tmp_path / "meshes", Reading(), tmp_path / "sheet.png") == EXIT_OK
    words = " ".join(capsys.readouterr().out.split())
    assert "10.0 x 8.0 x 12.0" in words
    assert "1 convex" in words
    picture = np.asarray(Image.open(tmp_path / "sheet.png"))
    assert picture.shape[1] == TILE
    # The camera stands at +x and +y, above: three sides show, in their own colours.
    colors = picture[:TILE].reshape(-1, 3).astype(int)
    strong = {tuple(row > row.max() / 2) for row in colors if row.max() > 2 * row.min() + 40}
    assert {(False, True, False), (True, True, False), (True, False, True)} <= strong


def test_what_needs_attention(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path / "cache"))
    write_stl(tmp_path / "meshes" / "unsure.stl", (5 * BOX)[triangles()])
    (tmp_path / "meshes" / "empty.stl").write_bytes(b"")
    assert run(tmp_path / "meshes", Reading(), tmp_path / "sheet.jpg") == EXIT_VERIFICATION
    out = " ".join(capsys.readouterr().out.split())
    assert "empty.stl is empty" in out
    assert "unsure.stl: longest side 10 fits neither m nor mm; give --unit" in out
    assert (tmp_path / "sheet.jpg").exists()
    with pytest.raises(UsageError, match=r"\.png"):
        run(tmp_path / "meshes", Reading(), tmp_path / "sheet.gif")


def test_each_row_is_printed_before_the_next_mesh_is_examined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a.stl").write_bytes(b"")
    (tmp_path / "b.stl").write_bytes(b"")
    events: list[str] = []
    monkeypatch.setattr(assets_check.Console, "print", lambda _, text: events.append(text[:1]))
    examined = assets_check.examine
    monkeypatch.setattr(assets_check, "examine", lambda *x: events.append(f"examine {x[2]}") or examined(*x))
    run(tmp_path, Reading(), tmp_path / "sheet.png")
    assert [event for event in events if event.strip()] == ["m", "examine a", "a", "examine b", "b", "2"]


@pytest.mark.skipif(util.find_spec("coacd") is None, reason="needs obpose[meshes]")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_check_that_is_killed_leaves_neither_files_nor_processes(tmp_path: Path, number: int):
    ring = trimesh.creation.torus(0.05, 0.015, major_sections=96, minor_sections=48)
    write_stl(tmp_path / "meshes" / "ring.stl", np.array(ring.triangles))
    (tmp_path / "temporary").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-m", "datagen.commands.entry", "assets", "check", "meshes", "--out", "sheet.png"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OBPOSE_CACHE": "cache", "TMPDIR": str(tmp_path / "temporary")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: cutters(process.pid), seconds=200, what="the process that cuts the mesh")
    running = cutters(process.pid)
    os.kill(process.pid, number)
    errors = errors_at_end(process)
    wait_until_gone(running)
    assert [path.name for path in tmp_path.iterdir() if path.name not in ("meshes", "temporary")] == []
    assert not list((tmp_path / "temporary").iterdir())
    if number == signal.SIGINT:
        assert process.returncode == EXIT_INTERRUPTED
        assert errors.splitlines()[-1].startswith("obpose-datagen: Interrupted; no sheet was written.")
        assert "Traceback" not in errors


def cutters(process: int) -> dict[int, bytes]:
    """Descendants of a process that run CoACD."""
    lines = {child: command_line(child) for child in descendants(process)}
    return {child: line for child, line in lines.items() if b"coacd_process" in line}
