"""What `obpose-bench search` tries of every system: few values, each with a reason, declared before any search.

No value here changes what the observation loss means, by which trials are compared.
"""

from benchmark.model_spec import Options

_FASTER: Options = {"train.learning_rate": 3e-3}
"""For a few minutes on one core."""
_SLOWER: Options = {"train.learning_rate": 3e-4}
"""As published, for longer trainings."""
_L2: Options = {"loss.attention": "l2", "loss.mask": 5.0}
"""The paper's other attention loss."""
_OBJECT_RAYS: Options = {"train.object_rays": 0.5}
"""More rays where the largest component is not, which the systems with a pre-scope have in any case."""

_POSED: tuple[Options, ...] = ({}, _FASTER, _L2, {"train.batch": 2})
_OBSURF: tuple[Options, ...] = ({}, _FASTER, _SLOWER, {"train.batch": 8})

TRIALS: dict[str, tuple[Options, ...]] = {
    "obpose-loc": _POSED,
    "obpose-none": _POSED,
    "obpose": _POSED,
    "ic-sbp": ({}, _FASTER, _L2, _OBJECT_RAYS),
    "slot-attention": ({}, _FASTER, _L2, _OBJECT_RAYS),
    "obsurf": _OBSURF,
    "obsurf-no-overlap": _OBSURF,
    "obsurf-no-overlap-depth": _OBSURF,
}
"""As many for each, so that none is searched more than another; the first are the defaults."""

SEARCHED_FROM: dict[str, Options] = {
    name: {"train.learning_rate": 1e-3} for name in ("ic-sbp", "obsurf", "obsurf-no-overlap")
}
"""The defaults that trials are changes of, where the choice of the search was frozen in the variants since."""
