"""Settings of learned systems, which rows are keyed by."""

import dataclasses
import math
from functools import reduce
from typing import Any

from obpose.config import Config

LATER: dict[str, Any] = {
    "model.attention.kind": "icsbp",
    "model.attention.mask_power": 3.0,
    "model.background": "component",
    "model.latent.colours": "given",
    "model.latent.frequencies": 3,
    "model.latent.means": "given",
    "model.latent.posterior_input": "state and code",
    "model.latent.posterior_std": 0.01,
    "model.latent.radius": 0.5,
    "model.latent.summary": "points",
    "model.object_field.density": "raw",
    "model.background_field.density": "raw",
    "model.pose.points": "own",
    "model.weights": "orthogonal",
    "loss.air_growth": 1.0,
    "loss.air_saturation": 3.0,
    "train.half_life": 0.1,
    "train.skip": 0.0,
}
"""Values of ObPose's configuration that came after the first published rows, with what was done before there was a
choice: left out where they are that, so that these rows keep their keys."""


def settings_of(config: Any) -> dict[str, Any]:
    """All values of a configuration on which results depend, nested as they are there."""
    settings = dataclasses.asdict(config)
    if math.isinf(config.train.minutes):
        settings["train"]["minutes"] = None  # steps count, and JSON has no inf
    if type(config) is not Config:
        return settings
    for name, before in LATER.items():
        *parents, last = name.split(".")
        place = reduce(dict.__getitem__, parents, settings)
        if place[last] == before:
            del place[last]
    if config.model.attention.kind == "icsbp":
        del settings["model"]["slot_attention"]
    return settings
