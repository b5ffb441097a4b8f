import shlex
from pathlib import Path

import pytest

from datagen.commands.cli import main
from datagen.errors import EXIT_OK
from datagen.inspect import dataset_card, stats
from datagen.schema import FIELDS
from datagen.storage.reader import Dataset
from tests.paths import ROOT
from tests.worlds import rendered


def test_the_card_says_what_the_dataset_is(tiny_dataset: Path):
    text = dataset_card.card(Dataset(tiny_dataset).spec, stats.summary(tiny_dataset))
    assert text.startswith("---\nlicense: mit\ntask_categories:\n- image-segmentation\n")
    for fact in (
        Dataset(tiny_dataset).spec["spec_hash"],
        "4 train, 2 val, 2 test",
        "64x64",
        "n<1K",
        "foreground share",
    ):
        assert fact in text


def test_the_card_is_the_folder_s_readme(tmp_path: Path):
    folder = rendered.write_dataset(tmp_path / "staged", [rendered.record(rendered.scene())])
    assert dataset_card.write_card(folder) == folder / "README.md"
    assert "# staged" in (folder / "README.md").read_text()


def test_the_loading_code_of_the_card_runs(tiny_dataset: Path):
    text = dataset_card.card(Dataset(tiny_dataset).spec, stats.summary(tiny_dataset))
    code = text.split("```python\n")[1].split("```")[0].replace("path/to/this/folder", str(tiny_dataset))
    names: dict = {}
    exec(code, names)
    assert set(names["record"]) >= {"rgb", "depth", "segmentation"}
    assert names["part"]["rgb"].shape == (1, 1, 64, 64, 3)


def test_the_commands_of_the_card_run(tiny_dataset: Path, capsys):
    text = dataset_card.card(Dataset(tiny_dataset).spec, stats.summary(tiny_dataset))
    commands = text.split("```sh\n")[1].split("```")[0].replace("path/to/this/folder", str(tiny_dataset)).splitlines()
    assert [command.split()[1] for command in commands] == ["verify", "regenerate"]
    for command in commands:
        assert main(shlex.split(command)[1:]) == EXIT_OK, capsys.readouterr()


def test_the_loading_code_reads_a_split_that_has_scenes(tiny_dataset: Path):
    spec = Dataset(tiny_dataset).spec | {"splits": {"train": 0, "val": 0, "test": 2}}
    text = dataset_card.card(spec, stats.summary(tiny_dataset))
    assert '.split("test")' in text
    assert "test-00000.h5" in text


def test_sizes_are_the_hub_s():
    assert [dataset_card.size_category(n) for n in (10, 999, 1000, 99_999, 10**8)] == [
        "n<1K",
        "n<1K",
        "1K<n<10K",
        "10K<n<100K",
        "n>10M",
    ]


def test_the_documentation_s_table_is_the_schema_s():
    text = (ROOT / "docs" / "dataset.md").read_text()
    assert dataset_card.field_table() in text, (
        "put the output of datagen.inspect.dataset_card.field_table() into docs/dataset.md"
    )
    assert all(f"| `{name}` |" in text for name in FIELDS)


def test_the_documentation_names_every_check():
    from datagen.verify import pixels

    text = (ROOT / "docs" / "dataset.md").read_text()
    surface = pixels.MESH_TOLERANCE + pixels.SURFACE_STEPS * pixels.DEPTH_SCALE
    for figure in (surface, pixels.MEDIAN_TOLERANCE, pixels.PLANE_TOLERANCE, pixels.SHELL):
        assert f"{1e3 * figure:.2f} mm" in text
    sources = "".join(path.read_text() for path in (ROOT / "datagen" / "verify").rglob("*.py"))
    names = {part.split('"')[0] for part in sources.split('Finding("')[1:]}
    assert names
    assert all(f"`{name}`" in text for name in names)


@pytest.mark.filterwarnings("ignore")  # of libraries while they are imported
def test_every_dataset_has_croissant_metadata(tiny_dataset: Path):
    mlcroissant = pytest.importorskip("mlcroissant")
    described = mlcroissant.Dataset(jsonld=tiny_dataset / "croissant.json")
    assert not described.metadata.issues.errors
    assert [record["splits/scenes"] for record in described.records("splits")] == [4, 2, 2]
