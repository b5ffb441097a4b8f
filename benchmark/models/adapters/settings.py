"""Settings of learned systems, which are part of the keys of rows."""

import dataclasses
import math
from functools import reduce
from typing import Any

from obpose.config import Config, SupervisedConfig

_OF_THE_BACKBONE: dict[str, Any] = {"model.backbone.scene_means": "given"}

_OF_OBPOSE: dict[str, Any] = {
    "model.attention.kind": "icsbp",
    "model.attention.mask_exponent": 3.0,
    "model.background": "component",
    **_OF_THE_BACKBONE,
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

LATER: dict[type, dict[str, Any]] = {Config: _OF_OBPOSE, SupervisedConfig: {**_OF_THE_BACKBONE, "loss.air_growth": 1.0}}
"""Settings introduced after the first published rows, by type of configuration, with the behaviour before.
Settings with these values are omitted, so that those rows keep their keys."""


def settings_of(config: Any) -> dict[str, Any]:
    """All values of a configuration that results depend on, nested as in the configuration."""
    settings = dataclasses.asdict(config)
    if math.isinf(config.train.minutes):
        settings["train"]["minutes"] = None  # steps count, and JSON has no inf
    for name, before in LATER.get(type(config), {}).items():
        *parents, last = name.split(".")
        place = reduce(dict.__getitem__, parents, settings)
        if place[last] == before:
            del place[last]
    if type(config) is Config and config.model.attention.kind == "icsbp":
        del settings["model"]["slot_attention"]
    return settings
