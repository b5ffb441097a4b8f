from pathlib import Path

import pytest

from datagen.errors import EXIT_OK
from obpose.commands.edit_arguments import main
from tests.obpose.commands.test_edit import MODEL


@pytest.fixture(scope="module")
def inferred(tiny_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "inferred"
    flags = ["--checkpoint", MODEL, "--data", str(tiny_dataset), "--refine", "0"]
    assert main(["infer", *flags, "--out", str(out)]) == EXIT_OK
    return out
