import io
import tarfile
from pathlib import Path

import numpy as np
import pytest

from datagen.formats.exporters.webdataset import write
from tests.datagen.formats.conftest import Export, source
from tests.worlds import rendered

pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries while they are imported


def test_samples_read_as_videosaur_and_slotcontrast_do(clips: Path, exported: Export):
    """Their loaders keep keys that begin with the wanted names, decode them, and drop what follows the first dot."""
    wds = pytest.importorskip("webdataset")
    shards = str(exported(clips, "webdataset") / "train-{000000..000000}.tar")
    data = wds.WebDataset(shards, shardshuffle=False)
    wanted = ("_", "video", "segmentations")
    data = data.map(lambda sample: {key: value for key, value in sample.items() if key.startswith(wanted)})
    data = data.decode("rgb").map(lambda sample: {key.split(".")[0]: value for key, value in sample.items()})
    samples = list(data)
    assert [sample["__key__"] for sample in samples] == ["000000", "000001"]
    for index, sample in enumerate(samples):
        np.testing.assert_array_equal(sample["video"], source(clips, index).rgb[:, 0])
        np.testing.assert_array_equal(sample["segmentations"][..., 0], source(clips, index).segmentation[:, 0])


def test_the_datasets_library_reads_every_split_and_camera(stills: Path, exported: Export, tmp_path: Path):
    datasets = pytest.importorskip("datasets")
    files = {"train": str(exported(stills, "webdataset") / "train-*.tar")}
    rows = datasets.load_dataset("webdataset", data_files=files, split="train", cache_dir=str(tmp_path / "cache"))
    rows, scene = rows.with_format("numpy"), source(stills)
    assert list(rows["__key__"]) == ["000000-0", "000000-1"]
    for view, row in enumerate(rows):
        np.testing.assert_array_equal(row["video.npy"], scene.rgb[:, view])
        np.testing.assert_array_equal(row["depth.npy"][..., 0], scene.depth[:, view])
        np.testing.assert_allclose(row["scene.json"]["K"], scene.k[:, view], rtol=1e-6)
        assert [each["category"] for each in row["scene.json"]["objects"]] == ["box", "cylinder", "sphere"]


def test_flow_has_rows_first_as_in_movi(exported: Export, tmp_path: Path):
    record = rendered.record(rendered.scene(), signals=("flow",))
    del record["flow/backward"]
    data = rendered.write_dataset(tmp_path / "data", [record])
    with tarfile.open(exported(data, "webdataset") / "train-000000.tar") as shard:
        names = [name for name in shard.getnames() if name.endswith("flow.npy")]
        assert names == ["000000.forward_flow.npy"]
        file = shard.extractfile(names[0])
        assert file is not None
        found = np.lib.format.read_array(io.BytesIO(file.read()))
    np.testing.assert_array_equal(found, record["flow/forward"][:, 0, ..., ::-1])
    assert np.any(found[..., 0] != found[..., 1])


def test_shards_have_a_largest_number_of_samples(clips: Path, tmp_path: Path):
    write(tmp_path, [source(clips, index) for index in (0, 1, 0)], samples_per_shard=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["train-000000.tar", "train-000001.tar"]
