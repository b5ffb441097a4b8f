"""What every recipe keeps, so that impossible settings are refused before anything is generated."""

import math
import re
from collections.abc import Iterator
from typing import Any

MOST_OBJECTS = 250
"""Ids are bytes, and 0 is the background."""

MOST_STEPS = 10_000
"""Steps of physics between two frames, 20 seconds at the default step."""

_POSITIVE = {
    "frames", "fps", "views", "resolution", "visibility_resolution", "attempts", "minimum", "size_skew", "tries",
    "half_extent", "workspace_half_extent", "table_size", "distance", "field_of_view", "push_duration",
}  # fmt: skip
_NOT_NEGATIVE = {
    "least_visible_pixels", "shape_pool", "gap", "speed", "drop_height", "spin", "push_start", "jitter", "key", "fill",
    "ambient", "rolling_friction", "spinning_friction", "rest", "drop", "slide", "roll", "push", "throw",
    "least_travel", "contact_gap", "rest_speed", "axial_noise", "quantisation",
}  # fmt: skip
_RANGES = {
    "size", "density", "friction", "restitution", "speed", "drop_height", "push_start", "push_duration", "key", "fill",
    "ambient", "lighting.elevation",
}  # fmt: skip
_LIMITS = {
    "objects.size": (0.01, 10, "metres"),
    "objects.sizes": (0.01, 10, "metres"),
    "objects.density": (10, 30_000, "kg/m^3"),
    "objects.friction": (0, 5, ""),
    "objects.restitution": (0, 1, ""),
    "lighting.elevation": (1, 90, "degrees"),
    "lighting.softness": (0, 45, "degrees"),
    "rig.elevation": (-89.9, 89.9, "degrees"),
    "rig.field_of_view": (1, 170, "degrees"),
    "physics.step": (1e-5, 1 / 120, "seconds"),
    "physics.gravity": (0.1, 100, "m/s^2"),
    "physics.table_friction": (0, 5, ""),
    "physics.table_restitution": (0, 1, ""),
    "physics.settle_seconds": (0, 60, "seconds"),
    "physics.deepest_overlap": (0, 0.001, "metres"),
    "physics.deepest_in_motion": (0, 0.01, "metres"),
}
"""Least and greatest value, and their unit: beyond these the simulator fails, or `verify` would object."""

_SHARES = ("_share", "edge_dropout", "dark_reflectance", "hue_width")
_COLORS = ("palette", "table_color")


def problems(recipe: dict[str, Any]) -> Iterator[str]:
    """One clause for every setting that no dataset can have, given a recipe as nested plain values."""
    wrong = [clause for name, value in constants(recipe) for clause in _problems_of(name, value)]
    yield from wrong or _contradictions(recipe)


def constants(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted name and value of every constant of a recipe."""
    for name, value in data.items():
        if isinstance(value, dict):
            yield from constants(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _problems_of(name: str, value: Any) -> Iterator[str]:
    leaf = name.rpartition(".")[2]
    values = value if isinstance(value, tuple) else (value,)
    low, high, unit = _LIMITS.get(name, (-math.inf, math.inf, ""))
    if not all(math.isfinite(x) for x in values if isinstance(x, float)):
        yield f"{name} is {value}, expected finite numbers"
    elif name in _LIMITS and not all(low <= x <= high for x in values):
        yield f"{name} is {value}, expected {low:.6g} to {high:.6g} {unit}".rstrip()
    elif leaf in _POSITIVE and not all(x > 0 for x in values):
        yield f"{name} is {value}, expected more than 0"
    elif leaf in _NOT_NEGATIVE and not all(x >= 0 for x in values):
        yield f"{name} is {value}, expected 0 or more"
    elif {leaf, name} & _RANGES and values[0] > values[-1]:
        yield f"{name} is {value}, expected the least before the greatest"
    elif leaf.endswith(_SHARES) and not all(0 <= x <= 1 for x in values):
        yield f"{name} is {value}, expected 0 to 1"
    elif leaf in _COLORS and not all(re.fullmatch(r"#[0-9a-fA-F]{6}", x) for x in values if x or leaf == "palette"):
        yield f"{name} is {value!r}, expected colours such as #ad2323"


def _contradictions(recipe: dict[str, Any]) -> Iterator[str]:
    """What settings that are possible by themselves are together."""
    objects, layout = recipe["objects"], recipe["layout"]
    if objects["minimum"] > objects["maximum"]:
        yield f"objects.minimum {objects['minimum']} exceeds objects.maximum {objects['maximum']}"
    if objects["maximum"] > MOST_OBJECTS:
        yield f"objects.maximum is {objects['maximum']}, expected at most {MOST_OBJECTS}"
    if layout["placement"] == "touching" and objects["minimum"] < 2:
        yield "objects.minimum is 1, expected at least 2 where layout.placement is touching"
    reach = max(abs(c) + h for c, h in zip(layout["center"], layout["workspace_half_extent"], strict=True))
    if reach > layout["table_size"] / 2:
        yield f"the workspace reaches {reach:.2f} m out, beyond a table of layout.table_size {layout['table_size']} m"
    steps = 1 / (recipe["fps"] * recipe["physics"]["step"])
    if steps > MOST_STEPS:
        yield f"fps {recipe['fps']} takes {steps:.0f} steps of physics.step a frame, expected at most {MOST_STEPS}"
    if not any(recipe["motion"]["weights"].values()):
        yield "motion.weights are all 0"
    if unknown := set(recipe["overrides"]) - {name for name, _ in constants(recipe)}:
        yield f"overrides names {', '.join(sorted(unknown))}, which are no constants"
