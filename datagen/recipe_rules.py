"""What every recipe keeps, so that impossible settings are refused before anything is generated."""

from collections.abc import Iterator
from typing import Any

MOST_OBJECTS = 250
"""Ids are bytes, and 0 is the background."""

_POSITIVE = {
    "frames", "fps", "views", "resolution", "visibility_resolution", "attempts", "minimum", "size", "sizes",
    "size_skew", "density", "tries", "half_extent", "workspace_half_extent", "table_size", "distance",
    "field_of_view", "step", "push_duration",
}  # fmt: skip
_NOT_NEGATIVE = {
    "least_visible_pixels", "shape_pool", "gap", "speed", "drop_height", "spin", "push_start", "jitter", "key", "fill",
    "ambient", "softness", "settle_seconds", "deepest_overlap", "friction", "restitution", "table_friction",
    "table_restitution", "rolling_friction", "spinning_friction", "rest", "drop", "slide", "roll", "push", "throw",
    "least_travel", "contact_gap", "rest_speed", "axial_noise", "quantisation", "gravity",
}  # fmt: skip
_RANGES = {
    "size", "density", "friction", "restitution", "speed", "drop_height", "push_start", "push_duration", "key", "fill",
    "ambient",
}  # fmt: skip
_SHARES = ("_share", "edge_dropout", "dark_reflectance", "hue_width")


def problems(recipe: dict[str, Any]) -> Iterator[str]:
    """One clause for every setting that no dataset can have, given a recipe as nested plain values."""
    for name, value in _constants(recipe):
        yield from _problems_of(name, value)
    objects, layout, rig = recipe["objects"], recipe["layout"], recipe["rig"]
    if objects["minimum"] > objects["maximum"]:
        yield f"objects.minimum {objects['minimum']} exceeds objects.maximum {objects['maximum']}"
    if objects["maximum"] > MOST_OBJECTS:
        yield f"objects.maximum is {objects['maximum']}, expected at most {MOST_OBJECTS}"
    if layout["placement"] == "touching" and objects["minimum"] < 2:
        yield "objects.minimum is 1, expected at least 2 where layout.placement is touching"
    reach = max(abs(c) + h for c, h in zip(layout["center"], layout["workspace_half_extent"], strict=True))
    if reach > layout["table_size"] / 2:
        yield f"the workspace reaches {reach:.2f} m out, beyond a table of layout.table_size {layout['table_size']} m"
    if not -90 < rig["elevation"] < 90:
        yield f"rig.elevation is {rig['elevation']}, expected between -90 and 90 degrees"
    if rig["field_of_view"] >= 180:
        yield f"rig.field_of_view is {rig['field_of_view']}, expected less than 180 degrees"
    if not any(recipe["motion"]["weights"].values()):
        yield "motion.weights are all 0"


def _constants(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, dict):
            yield from _constants(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _problems_of(name: str, value: Any) -> Iterator[str]:
    leaf = name.rpartition(".")[2]
    values = value if isinstance(value, tuple) else (value,)
    if leaf in _POSITIVE and not all(x > 0 for x in values):
        yield f"{name} is {value}, expected more than 0"
    if leaf in _NOT_NEGATIVE and not all(x >= 0 for x in values):
        yield f"{name} is {value}, expected 0 or more"
    if leaf in _RANGES and values[0] > values[-1]:
        yield f"{name} is {value}, expected the least before the greatest"
    if leaf.endswith(_SHARES) and not all(0 <= x <= 1 for x in values):
        yield f"{name} is {value}, expected 0 to 1"
