import numpy as np
import pytest
from fabricated import write_dataset

from benchmark.clips import ClipSequence
from benchmark.registry import MODELS, find_model
from datagen import storage
from datagen.errors import UsageError


def test_an_unknown_name_gets_the_nearest():
    with pytest.raises(UsageError, match="Unknown model 'plane_dbscan'; did you mean 'plane-dbscan'"):
        find_model("plane_dbscan")


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_keeps_the_contract(name: str, tmp_path):
    clips = ClipSequence(storage.Dataset(write_dataset(tmp_path / "data", scenes=1, views=2)).split("train"))
    model = find_model(name).build()
    model.fit(clips, clips, seed=0, budget=5.0)
    prediction = model.segment(clips[0])
    assert prediction.labels.shape == clips[0].depth.shape
    assert np.issubdtype(prediction.labels.dtype, np.integer)
    assert prediction.labels.min() >= 0
