"""What `obpose-bench search` tries of every system: few values, each with a reason, declared before any search.

Only what training needs of a system's own is tried: no value here changes what the observation loss means, by which
trials are compared.
"""

from benchmark.model_spec import Options

RATES: tuple[Options, ...] = ({}, {"train.learning_rate": 3e-4}, {"train.learning_rate": 3e-3})
"""For a few minutes on one core, and for what was published with a longer training."""

TRIALS: dict[str, tuple[Options, ...]] = {
    "obpose-loc": (*RATES, {"train.batch": 2}),
    "obpose-none": (*RATES, {"train.batch": 2}),
    "obpose": (*RATES, {"train.batch": 2}),
    "ic-sbp": (*RATES, {"train.batch": 2}),
    "slot-attention": (*RATES, {"train.batch": 2}),
    "obsurf": (*RATES, {"train.batch": 2}),
    "obsurf-no-overlap": (*RATES, {"train.batch": 2}),
    "obsurf-no-overlap-depth": (*RATES, {"train.batch": 2}),
}
"""As many for each, so that none is searched more than another; the first are the defaults."""
