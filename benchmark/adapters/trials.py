"""What `obpose-bench search` tries of every system: few values, each with a reason, declared before any search.

No value here changes what the observation loss means, by which trials are compared.
"""

from benchmark.model_spec import Options

_FASTER: Options = {"train.learning_rate": 3e-3}
"""For a few minutes on one core."""
_L2: Options = {"loss.attention": "l2", "loss.mask": 5.0}
"""The paper's other attention loss."""
_OBJECT_RAYS: Options = {"train.object_rays": 0.5}
"""More rays where the largest component is not, which the systems with a pre-scope have in any case."""

_UNIT_SCALES: Options = {"model.decoder.unit_scales": True}
"""Slots that matter to ObSuRF's fields from the first step on."""

_FASTEST: Options = {"train.learning_rate": 1e-2}
_FINER: Options = {"model.object_field.position_frequencies": 8}
"""Fields that fill the world, not a box of 20 cm."""
_FINEST: Options = {"model.object_field.position_frequencies": 10}
"""As published."""

_POSED: tuple[Options, ...] = ({}, _FASTER, _L2, {"train.batch": 2})
_WORLD: tuple[Options, ...] = ({}, _FASTER, _L2, _OBJECT_RAYS)
_OBSURF: tuple[Options, ...] = ({}, _FASTER, {**_FASTER, **_UNIT_SCALES}, {**_FASTER, **_OBJECT_RAYS})

TRIALS: dict[str, tuple[Options, ...]] = {
    "obpose-loc": _POSED,
    "obpose-none": _POSED,
    "obpose": _POSED,
    "ic-sbp": (*_WORLD, _FASTEST, {**_FASTER, **_FINER}),
    "slot-attention": (*_WORLD, _FINER, _FINEST),
    "obsurf": _OBSURF,
    "obsurf-no-overlap": _OBSURF,
    "obsurf-no-overlap-depth": _OBSURF,
}
"""The first are the defaults. None of ours is searched more than another; after the first table was seen `ic-sbp` and
`slot-attention` were given two trials more."""

_SLOW: Options = {"train.learning_rate": 1e-3}

SEARCHED_FROM: dict[str, Options] = {
    "ic-sbp": _SLOW,
    "obsurf": {**_SLOW, "model.decoder.unit_scales": False},
    "obsurf-no-overlap-depth": {**_SLOW, "train.object_rays": 0.0},
}
"""The defaults that trials are changes of, where the choice of the search was frozen in the variants since."""

LABELLED_TRIALS: dict[str, int] = {"obpose": 70, "supervised": 70, "obsurf": 30}
"""About how many short runs, by architecture, were looked at with labels before anything was declared: on validation
scenes of `moving`, those in which what `obpose` and its variants have in common was found; on pairs of balls."""
