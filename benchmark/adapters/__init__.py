"""What is scored besides the models that need no training: those that learn, and label maps made elsewhere.

PyTorch takes seconds to import, so that only building a model does it.
"""

import dataclasses
from functools import partial

from benchmark.interface import Segmenter
from benchmark.model_spec import ModelSpec, Options
from obpose.config import VARIANTS, make_config

DESCRIPTIONS = {
    "obpose": "objects at their location and rotation",
    "obpose-loc": "the same at their location only",
    "obpose-none": "the same in the workspace's frame",
    "obpose-as-published": "obpose without our additions",
}


def _build(variant: str, options: Options) -> Segmenter:
    from benchmark.adapters.obpose import ObPoseSegmenter

    return ObPoseSegmenter(variant, **options)


def _spec(variant: str) -> ModelSpec:
    config = make_config(variant)
    return ModelSpec(
        partial(_build, variant),
        version=2,
        description=DESCRIPTIONS[variant],
        kind="learned",
        priors=("slots", "background slot", "camera pose", "plane"),
        budget=60 * config.train.minutes,
        extra=("att",),
        settled_with_labels=True,
        settings=dataclasses.asdict(config),
    )


LEARNED = {variant: _spec(variant) for variant in VARIANTS}
