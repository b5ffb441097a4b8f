from pathlib import Path

import torch

from obpose.creation.origin import Origin
from obpose.viewer.sampling import Sampler
from tests.obpose.creation.scenes import CAMERA, some_model


def test_seeds_follow_each_other_and_begin_anew():
    origin = Origin(some_model(), Path("no-prior-here"), "name", "hash")
    first, second = Sampler(origin), Sampler(origin)
    one, two = first.next(1, (CAMERA,)), first.next(1, (CAMERA,))
    again = second.next(1, (CAMERA,))
    assert torch.equal(one.what, again.what)
    assert not torch.equal(one.what, two.what)
    assert first.seed == 1
