from pathlib import Path

import pytest

from benchmark.studies.creation import probes_cli, samples_cli, views_cli
from datagen.errors import EXIT_USAGE


@pytest.mark.parametrize(
    ("main", "flags", "said"),
    [
        (views_cli.main, ["--scenes", "0"], "--scenes 0: expected 1 or more."),
        (views_cli.main, ["--frames", "0"], "--frames 0: expected 1 or more."),
        (probes_cli.main, ["--learn-scenes", "-1"], "--learn-scenes -1: expected 1 or more."),
        (samples_cli.main, ["--seed", "-3"], "--seed -3: expected 0 or more."),
        (samples_cli.main, ["--picture", "a.jpg"], "--picture a.jpg: expected a name that ends with .png."),
        (probes_cli.main, ["--csv", "a.txt"], "--csv a.txt: expected a name that ends with .csv."),
        (samples_cli.main, ["--track", "nowhere"], "Unknown track"),
    ],
)
def test_what_makes_no_sense_is_said_before_anything_is_made(main, flags, said, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    assert main(flags) == EXIT_USAGE
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
