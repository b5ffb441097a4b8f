import json
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from datagen.errors import DatagenError, UsageError
from datagen.formats.export import EXPORT_FILE, export
from datagen.formats.export_card import export_card
from datagen.formats.exporters import EXPORTERS, Format
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from datagen.storage.spec import SPEC_FILE, read_spec, spec_text, with_splits
from tests.worlds import rendered

FORMATS: list[Format] = list(EXPORTERS)


@pytest.fixture
def dataset_for(clips: Path, clevr: Path):
    return lambda name: clevr if name == "obsurf" else clips


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.filterwarnings("ignore")  # of libraries while they are imported
def test_the_card_says_how_to_load_the_export(dataset_for, tmp_path: Path, name: Format, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    export(dataset_for(name), tmp_path / "out", name)
    card = (tmp_path / "out" / "README.md").read_text()
    assert Dataset(dataset_for(name)).spec["spec_hash"] in card
    assert "## Not included" in card
    code = card.split("```python\n")[1].split("```")[0].replace("path/to/this/folder", str(tmp_path / "out"))
    exec(code, {})


def test_the_card_loads_a_split_that_was_exported(clips: Path):
    text = export_card(Dataset(clips).spec, EXPORTERS["rgbd"], {"test": 2})
    assert "path/to/this/folder/test/000000" in text


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.filterwarnings("ignore")
def test_croissant_metadata_is_valid_and_every_pattern_finds_files(dataset_for, tmp_path: Path, name: Format):
    mlcroissant = pytest.importorskip("mlcroissant")
    logging.getLogger("absl").setLevel(logging.ERROR)
    export(dataset_for(name), tmp_path / "out", name)
    path = tmp_path / "out" / "croissant.json"
    described = mlcroissant.Dataset(jsonld=path)
    assert not described.metadata.issues.errors
    assert [record["splits/name"] for record in described.records("splits")] == ["train"]
    for files in json.loads(path.read_text())["distribution"]:
        assert list((tmp_path / "out").glob(files["includes"])), files


def test_equal_datasets_give_equal_bytes(clips: Path, tmp_path: Path):
    for out in ("a", "b"):
        export(clips, tmp_path / out, "webdataset")
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert files == ["README.md", "croissant.json", "export.json", "train-000000.tar"]
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in files)


def test_a_failed_export_leaves_nothing(clips: Path, tmp_path: Path):
    @contextmanager
    def full(_total: int) -> Iterator[Callable[[], None]]:
        yield lambda: None
        raise OSError(28, "No space left on device")

    with pytest.raises(DatagenError, match="No space left"):
        export(clips, tmp_path / "out", "rgbd", progress=full)
    assert os.listdir(tmp_path) == []


def test_only_exports_are_replaced(clips: Path, stills: Path, tmp_path: Path):
    out = tmp_path / "out"
    export(clips, out, "rgbd")
    with pytest.raises(UsageError, match="not empty"):
        export(stills, out, "coco")
    export(stills, out, "coco", overwrite=True)
    assert json.loads((out / EXPORT_FILE).read_text())["format"] == "coco"
    assert not (out / "train" / "000000" / "rgb").exists()
    assert os.listdir(tmp_path) == ["out"]
    (out / EXPORT_FILE).unlink()
    with pytest.raises(UsageError, match="did not export"):
        export(clips, out, "rgbd", overwrite=True)
    assert (out / "annotations").exists()


def test_a_failed_export_keeps_the_one_that_it_was_to_replace(clips: Path, tmp_path: Path):
    export(clips, tmp_path / "out", "rgbd")
    with pytest.raises(UsageError, match="320x240"):
        export(clips, tmp_path / "out", "obsurf", overwrite=True)
    assert json.loads((tmp_path / "out" / EXPORT_FILE).read_text())["format"] == "rgbd"


def test_an_export_into_its_dataset_or_around_it_is_refused(clips: Path):
    for out in (clips, clips / "out", clips.parent):
        with pytest.raises(UsageError, match="lie in each other"):
            export(clips, out, "rgbd", overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_link_that_leads_to_itself_is_refused(clips: Path, tmp_path: Path, overwrite: bool):
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(UsageError, match="circle is a link that leads to itself; give another --out"):
        export(clips, tmp_path / "circle", "rgbd", overwrite=overwrite)


def test_splits_without_scenes_are_refused(clips: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="has no scenes in val, test"):
        export(clips, tmp_path / "out", "rgbd", splits=("val", "test"))


def test_a_dataset_without_images_has_to_be_rendered_first(tmp_path: Path):
    data = write_without(tmp_path / "data", "rgb")
    with pytest.raises(UsageError, match=r"needs rgb, .* Render it first: obpose-datagen render --from"):
        export(data, tmp_path / "out", "rgbd")


def test_splits_that_have_the_fields_are_named(tmp_path: Path):
    data, record = (
        write_without(tmp_path / "data", "rgb", "scene/description"),
        rendered.record(rendered.scene(frames=1)),
    )
    facts = with_splits(read_spec(data), {"train": 1, "val": 1})
    (data / SPEC_FILE).write_text(spec_text(facts))
    rendered.write_shard(data, facts, "val", 0, [pack(record)])
    with pytest.raises(UsageError, match=r"needs rgb, .* Choose --splits val, or another --format"):
        export(data, tmp_path / "out", "coco")


def write_without(folder: Path, *fields: str) -> Path:
    """A dataset of one scene that lacks some fields."""
    record = rendered.record(rendered.scene(frames=1))
    return rendered.write_dataset(folder, [{name: record[name] for name in record if name not in fields}])


def test_an_incomplete_dataset_is_refused(tmp_path: Path):
    folder = rendered.write_dataset(tmp_path / "data", [rendered.record(rendered.scene(frames=1))])
    (folder / "train-00000.h5").unlink()
    with pytest.raises(DatagenError, match="is incomplete"):
        export(folder, tmp_path / "out", "rgbd")
    assert not (tmp_path / "out").exists()


def test_cards_of_imported_images_do_not_claim_a_licence(clips: Path):
    spec = Dataset(clips).spec
    generated = export_card(spec, EXPORTERS["rgbd"], {"train": 2})
    assert generated.startswith("---\nlicense: mit\n")
    assert "- synthetic\npretty_name: obpose staged (RGB-D folders)\n---\n" in generated
    imported = export_card({**spec, "import": {"format": "rgbd"}}, EXPORTERS["rgbd"], {"train": 2})
    assert imported.startswith("---\nlicense: other\n")
    assert "synthetic" not in imported


def test_scenes_that_cannot_be_rendered_get_other_advice(tmp_path: Path):
    data = write_without(tmp_path / "data", "scene/description")
    with pytest.raises(UsageError, match="320x240 pixels, not 64x64; choose another --format"):
        export(data, tmp_path / "out", "obsurf")
