"""Rules that every recipe keeps, so that impossible settings are refused before any scene is generated."""

import math
import re
from collections.abc import Collection, Iterator
from typing import Any

MOST_OBJECTS = 250
"""Ids are bytes, and 0 is the background."""

MOST_STEPS = 10_000
"""Largest number of steps of physics between two frames, 20 seconds at the default step."""

MOST_STEPS_OF_A_SCENE = 1_000_000
"""Largest number of steps of physics of a scene, the time in which it settles included."""

MOST_CAMERA_POSES = 5000
"""Largest number of camera poses of a scene whose cameras move; every scene stores them in its description."""

_SHARE = (0, 1, "")

LIMITS: dict[str, tuple[int | float, int | float, str]] = {
    "frames": (1, 10_000, ""),
    "fps": (0.001, 1000, "frames a second"),
    "views": (1, 360, ""),
    "resolution": (1, 4096, "pixels"),
    "least_visible_pixels": (0, 4096**2, "pixels"),
    "visibility_resolution": (1, 4096, "pixels"),
    "attempts": (1, 10_000, ""),
    "objects.minimum": (0, math.inf, ""),
    "objects.maximum": (0, math.inf, ""),
    "objects.size": (0.01, 10, "metres"),
    "objects.sizes": (0.01, 10, "metres"),
    "objects.size_skew": (0.001, 1000, ""),
    "objects.shape_pool": (0, 500_000, "shapes"),
    "objects.density": (10, 30_000, "kg/m^3"),
    "objects.friction": (0, 5, ""),
    "objects.restitution": _SHARE,
    "layout.stack_share": _SHARE,
    "layout.container_share": _SHARE,
    "layout.center": (-100, 100, "metres"),
    "layout.half_extent": (0.001, 100, "metres"),
    "layout.gap": (0, 100, "metres"),
    "layout.upright_share": _SHARE,
    "layout.tries": (1, 10_000, ""),
    "layout.workspace_half_extent": (0.001, 100, "metres"),
    "layout.table_size": (0.01, 100, "metres"),
    "layout.table_sizes": (0.01, 100, "metres"),
    **dict.fromkeys(
        (f"motion.weights.{kind}" for kind in ("rest", "drop", "slide", "roll", "push", "throw")), (0, 1e6, "")
    ),
    "motion.speed": (0, 100, "m/s"),
    "motion.drop_height": (0, 10, "metres"),
    "motion.spin": (0, 1000, "rad/s"),
    "motion.push_start": (0, 10_000, "seconds"),
    "motion.push_duration": (0.001, 10_000, "seconds"),
    "motion.aim_share": _SHARE,
    "motion.least_travel": (0, 100, "metres"),
    "motion.contact_gap": (0, 0.02, "metres"),
    "motion.contact_share": _SHARE,
    "motion.rest_speed": (0, 100, "m/s"),
    "appearance.one_hue_share": _SHARE,
    "appearance.hue_width": _SHARE,
    "appearance.metal_share": _SHARE,
    "appearance.pattern_share": _SHARE,
    "rig.distance": (0.05, 100, "metres"),
    "rig.elevation": (-89.9, 89.9, "degrees"),
    "rig.field_of_view": (1, 170, "degrees"),
    "rig.target": (-100, 100, "metres"),
    "rig.azimuth": (-3600, 3600, "degrees"),
    "rig.jitter": (0, 10, "metres"),
    "rig.distances": (0.05, 100, "metres"),
    "rig.elevations": (-89.9, 89.9, "degrees"),
    "rig.azimuths": (-3600, 3600, "degrees"),
    "rig.fields_of_view": (1, 170, "degrees"),
    "rig.orbit": (-3600, 3600, "degrees"),
    "rig.travel": (-100, 100, "metres"),
    "rig.shake": (0, 1, "metres"),
    "rig.sway": (0, 30, "degrees"),
    "lighting.softness": (0, 45, "degrees"),
    "lighting.elevation": (1, 90, "degrees"),
    "lighting.key": (0, 100, ""),
    "lighting.fill": (0, 100, ""),
    "lighting.ambient": (0, 100, ""),
    "lighting.exposure": (0.01, 100, ""),
    "lighting.tint": (0, 1, ""),
    "physics.step": (1e-5, 1 / 120, "seconds"),
    "physics.gravity": (0.1, 100, "m/s^2"),
    "physics.table_friction": (0, 5, ""),
    "physics.table_restitution": _SHARE,
    "physics.rolling_friction": (0, 1, "metres"),
    "physics.spinning_friction": (0, 1, "metres"),
    "physics.deepest_overlap": (0, 0.001, "metres"),
    "physics.deepest_in_motion": (0, 0.01, "metres"),
    "physics.settle_seconds": (0, 60, "seconds"),
    "sensor.axial_noise": (0, 0.1, "metres"),
    "sensor.edge_dropout": _SHARE,
    "sensor.grazing_angle": (0, 90, "degrees"),
    "sensor.dark_reflectance": _SHARE,
    "sensor.quantisation": (0, 0.1, "metres"),
    "sensor.depth_step": (0, 0.1, "metres"),
    "sensor.nearest": (0, 10, "metres"),
    "sensor.farthest": (0, 10, "metres"),
}
"""Least and greatest value of every number of a recipe, and their unit; pairs and lists hold such numbers."""

OPTIONAL_RANGES = {
    "rig.distances": "rig.distance",
    "rig.elevations": "rig.elevation",
    "rig.azimuths": "rig.azimuth",
    "rig.fields_of_view": "rig.field_of_view",
    "layout.table_sizes": "layout.table_size",
}
"""Pairs of a least and a greatest value that may be empty, and the constant that counts then."""

RANGES = {
    *OPTIONAL_RANGES,
    "objects.size", "objects.density", "objects.friction", "objects.restitution", "motion.speed", "motion.drop_height",
    "motion.push_start", "motion.push_duration", "lighting.elevation", "lighting.key", "lighting.fill",
    "lighting.ambient", "lighting.exposure",
}  # fmt: skip
"""Pairs of a least and a greatest value."""

_COLORS = ("appearance.palette", "appearance.table_color")


def problems(recipe: dict[str, Any]) -> Iterator[str]:
    """One clause for each impossible setting of a recipe, given as nested plain values."""
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
    values = value if isinstance(value, tuple) else (value,)
    if name in LIMITS:
        low, high, unit = LIMITS[name]
        if not all(math.isfinite(x) for x in values if isinstance(x, float)):
            yield f"{name} is {value}, expected finite numbers"
        elif not all(low <= x <= high for x in values):
            yield f"{name} is {value}, expected {span(low, high)} {unit}".rstrip()
        elif name in OPTIONAL_RANGES and len(values) not in (0, 2):
            yield f"{name} has {len(values)} numbers, expected a least and a greatest one, or none"
        elif name in RANGES and values and values[0] > values[-1]:
            yield f"{name} is {value}, expected the least before the greatest"
    elif name == "appearance.finishes" and not values:
        yield f"{name} names none, expected at least one"
    elif name == "objects.categories" and (
        unknown := {name for name in values if not name.startswith("mesh:")} - _categories(values)
    ):
        names = ", ".join(sorted(_categories(values)))
        yield f"objects.categories has unknown {', '.join(sorted(unknown))}, expected some of {names}"
    elif name in _COLORS and not all(re.fullmatch(r"#[0-9a-fA-F]{6}", x) for x in values if x or name == _COLORS[0]):
        yield f"{name} is {value!r}, expected colours such as #ad2323"


def span(low: int | float, high: int | float) -> str:
    """Format a range for a message; large whole numbers get separators."""
    least, greatest = (f"{end:,}" if isinstance(end, int) and end >= 10_000 else f"{end:.6g}" for end in (low, high))
    return f"{least} to {greatest}" if math.isfinite(high) else f"{least} or more"


def _categories(wanted: Collection[str]) -> set[str]:
    """Names of the catalog; it is only imported where a recipe names any."""
    if not wanted:
        return set()
    from datagen.catalog import CATEGORIES

    return set(CATEGORIES)


def _contradictions(recipe: dict[str, Any]) -> Iterator[str]:
    """Settings that contradict each other."""
    objects, layout = recipe["objects"], recipe["layout"]
    if objects["minimum"] > objects["maximum"]:
        yield f"objects.minimum {objects['minimum']} exceeds objects.maximum {objects['maximum']}"
    if objects["maximum"] > MOST_OBJECTS:
        yield f"objects.maximum is {objects['maximum']}, expected at most {MOST_OBJECTS}"
    if layout["placement"] == "touching" and objects["minimum"] < 2:
        yield f"objects.minimum is {objects['minimum']}, expected at least 2 where layout.placement is touching"
    reach = max(abs(c) + h for c, h in zip(layout["center"], layout["workspace_half_extent"], strict=True))
    name, table_size = _least(layout, "table_sizes", "table_size")
    if reach > table_size / 2:
        yield f"the workspace reaches {reach:.2f} m out, beyond a table of layout.{name} {table_size} m"
    width, height = recipe["visibility_resolution"]
    if recipe["least_visible_pixels"] > width * height:
        yield (
            f"least_visible_pixels is {recipe['least_visible_pixels']}, but a frame of visibility_resolution has only "
            f"{width * height} pixels"
        )
    nearest, farthest = recipe["sensor"]["nearest"], recipe["sensor"]["farthest"]
    if nearest >= farthest:
        yield f"sensor.nearest {nearest} is not below sensor.farthest {farthest}"
    shortest, step = recipe["motion"]["push_duration"][0], recipe["physics"]["step"]
    if recipe["motion"]["moving"] and recipe["motion"]["weights"]["push"] and shortest < step:
        yield f"motion.push_duration starts at {shortest} s, below physics.step, {step:.4g} s"
    if not any(recipe["motion"]["weights"].values()):
        yield "motion.weights are all 0"
    if unknown := set(recipe["overrides"]) - {name for name, _ in constants(recipe)}:
        yield f"overrides names {', '.join(sorted(unknown))}, which are no constants"
    poses = recipe["frames"] * recipe["views"]
    if recipe["rig"]["motion"] != "still" and poses > MOST_CAMERA_POSES:
        yield f"frames x views is {poses:,}, expected at most {MOST_CAMERA_POSES:,} with moving cameras"
    yield from _endless(recipe)
    yield from _below_the_table(recipe["rig"])


def _endless(recipe: dict[str, Any]) -> Iterator[str]:
    """Check the number of physics steps."""
    fps, physics = recipe["fps"], recipe["physics"]
    steps = 1 / (fps * physics["step"])
    if steps > MOST_STEPS:
        yield f"fps {fps} takes {steps:.0f} steps of physics.step a frame, expected at most {MOST_STEPS}"
        return
    steps = max(1, math.ceil(steps))
    total = steps * (recipe["frames"] - 1 + fps * physics["settle_seconds"])
    if total > MOST_STEPS_OF_A_SCENE:
        yield (
            f"frames, fps, physics.step and physics.settle_seconds take {total:,.0f} steps a scene, expected at most "
            f"{MOST_STEPS_OF_A_SCENE:,}"
        )


def _below_the_table(rig: dict[str, Any]) -> Iterator[str]:
    """Check for cameras below the table's top, which would show its underside."""
    elevation = _least(rig, "elevations", "elevation")[1]
    heights = [
        rig["target"][2] + distance * math.sin(math.radians(elevation))
        for distance in rig["distances"] or (rig["distance"],)
    ]
    if min(heights) <= 0:
        yield (
            f"rig.target, rig.distance and rig.elevation put the cameras at a height of {100 * min(heights):.1f} cm "
            "above the table's top, expected more than 0; raise rig.elevation or the third number of rig.target"
        )


def _least(values: dict[str, Any], optional: str, default: str) -> tuple[str, float]:
    """Name and least value of a range, or of the constant that counts if the range is empty."""
    return (optional, values[optional][0]) if values[optional] else (default, values[default])
