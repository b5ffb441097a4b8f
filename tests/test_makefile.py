import shutil
import subprocess
from pathlib import Path

import pytest

from tests.paths import ROOT


@pytest.mark.skipif(not shutil.which("make"), reason="needs make on the PATH")
@pytest.mark.parametrize("value", ["", " "])
def test_an_empty_python_is_refused_in_one_message(tmp_path: Path, value: str):
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    found = subprocess.run(["make", f"PYTHON={value}", "demo"], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode
    assert "PYTHON is empty; expected an interpreter, 3.11 or newer. Leave PYTHON out, or name one" in found.stderr
    assert not (tmp_path / ".venv").exists()
