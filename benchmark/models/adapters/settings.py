"""Settings of learned systems, by which rows are keyed."""

import dataclasses
import math
from typing import Any


def settings_of(config: Any) -> dict[str, Any]:
    """Give all values of a configuration on which results depend, nested as in the configuration."""
    settings = dataclasses.asdict(config)
    if math.isinf(config.train.minutes):
        settings["train"]["minutes"] = None  # steps count, and JSON has no inf
    return settings
