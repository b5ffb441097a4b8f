"""Colours, materials and patterns of objects and table, by `Appearance.style`."""

import colorsys
import dataclasses

import numpy as np

from datagen.config import Appearance
from datagen.scene import Material, Pattern, Vector, rounded, vector

PATTERNS: tuple[Pattern, ...] = ("two-tone", "checker", "stripes", "noise", "wood", "dots")

_ROUGHNESS = {"rubber": (0.75, 0.95), "plastic": (0.3, 0.6), "ceramic": (0.12, 0.3), "metal": (0.15, 0.4)}
_STRONG_CONTRAST = 0.75
_WEAK_CONTRAST = 0.35


def sample_materials(appearance: Appearance, sizes: list[float], rng: np.random.Generator) -> tuple[Material, ...]:
    """One material for each object, given the objects' longest sides in metres."""
    if appearance.style == "same-colour":
        shared = _plain(_finish(appearance, rng), _color(appearance, rng))
        return tuple(shared for _ in sizes)
    hue = rng.uniform() if rng.uniform() < appearance.one_hue_share else None
    return tuple(_material(appearance, size, hue, rng) for size in sizes)


def _material(appearance: Appearance, size: float, hue: float | None, rng: np.random.Generator) -> Material:
    material = _plain(_finish(appearance, rng), _color(appearance, rng, hue))
    if appearance.style == "two-colour":
        pattern: Pattern = "two-tone" if rng.uniform() < 0.7 else "stripes"
        color2 = _contrasting(material.color, _STRONG_CONTRAST, appearance, hue, rng)
        return _patterned(material, pattern, color2, size * rng.uniform(0.5, 0.9), rng)
    if appearance.style == "textured" or rng.uniform() < appearance.pattern_share:
        patterns = PATTERNS if appearance.style == "varied" else PATTERNS[1:]
        pattern = patterns[rng.integers(len(patterns))]
        color2 = _contrasting(material.color, _WEAK_CONTRAST, appearance, hue, rng)
        return _patterned(material, pattern, color2, size * rng.uniform(0.15, 0.4), rng)
    return material


def _finish(appearance: Appearance, rng: np.random.Generator) -> str:
    if rng.uniform() < appearance.metal_share:
        return "metal"
    return str(rng.choice(appearance.finishes))


def _plain(finish: str, color: Vector) -> Material:
    roughness = rounded(sum(_ROUGHNESS[finish]) / 2)
    return Material(finish, color, roughness=roughness, metalness=float(finish == "metal"))


def _patterned(
    material: Material, pattern: Pattern, color2: Vector, period: float, rng: np.random.Generator
) -> Material:
    axis = rng.normal(size=3)
    axis /= np.sqrt(np.sum(axis**2))
    return dataclasses.replace(
        material, pattern=pattern, color2=color2, period=rounded(max(period, 0.008)), axis=vector(axis)
    )


def _color(appearance: Appearance, rng: np.random.Generator, hue: float | None = None) -> Vector:
    if appearance.palette:
        return hex_color(str(rng.choice(appearance.palette)))
    if hue is None:
        return vector(colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(0.3, 0.95), rng.uniform(0.5, 0.95)))
    near = (hue + appearance.hue_width * rng.uniform(-0.5, 0.5)) % 1
    return vector(colorsys.hsv_to_rgb(near, rng.uniform(0.6, 0.9), rng.uniform(0.5, 0.9)))


def _contrasting(
    color: Vector, distance: float, appearance: Appearance, hue: float | None, rng: np.random.Generator
) -> Vector:
    """A second colour at least so far away in sRGB; within one hue there is only lighter and darker."""
    if hue is not None and not appearance.palette:
        h, s, v = colorsys.rgb_to_hsv(*color)
        return vector(colorsys.hsv_to_rgb(h, s, v * rng.uniform(0.45, 0.65)))
    candidates = [_color(appearance, rng) for _ in range(12)]
    far = [c for c in candidates if np.sqrt(np.sum(np.subtract(c, color) ** 2)) >= distance]
    if far:
        return far[0]
    if appearance.palette:  # the farthest allowed colour
        return max(map(hex_color, appearance.palette), key=lambda c: np.sum(np.subtract(c, color) ** 2))
    return vector(1.0 - round(c) for c in color)


def sample_table(appearance: Appearance, rng: np.random.Generator) -> Material:
    """Wood, cloth, tiles or plain paint in colours of furniture."""
    if appearance.table_color:
        return Material("paint", hex_color(appearance.table_color), roughness=0.7)
    kind = str(rng.choice(["wood", "cloth", "tiles", "paint"], p=[0.35, 0.2, 0.1, 0.35]))
    if kind == "paint" or not appearance.table_textures:
        return Material("paint", _table_color((0.0, 1.0), (0.0, 0.25), (0.45, 0.85), rng), roughness=0.6)
    if kind == "wood":
        color = _table_color((0.05, 0.1), (0.3, 0.6), (0.4, 0.75), rng)
        return _table_pattern("wood", color, "wood", 0.93, rng.uniform(0.03, 0.08), rng)
    if kind == "cloth":
        color = _table_color((0.0, 1.0), (0.1, 0.5), (0.35, 0.8), rng)
        return _table_pattern("cloth", color, "noise", 0.88, rng.uniform(0.01, 0.03), rng)
    color = _table_color((0.0, 1.0), (0.0, 0.2), (0.6, 0.85), rng)
    return _table_pattern("tiles", color, "checker", 0.85, rng.uniform(0.1, 0.2), rng)


def _table_color(
    hue: tuple[float, float], saturation: tuple[float, float], value: tuple[float, float], rng: np.random.Generator
) -> Vector:
    return vector(colorsys.hsv_to_rgb(rng.uniform(*hue), rng.uniform(*saturation), rng.uniform(*value)))


def _table_pattern(
    name: str, color: Vector, pattern: Pattern, darkening: float, period: float, rng: np.random.Generator
) -> Material:
    angle = rng.uniform(0, np.pi)
    return Material(
        name,
        color,
        vector(darkening * np.array(color)),
        pattern,
        rounded(period),
        vector([np.cos(angle), np.sin(angle), 0.0]),
        roughness=0.8,
    )


def sample_backdrop(rng: np.random.Generator) -> Vector:
    """A grey for what lies beyond the table."""
    return vector(np.full(3, rng.uniform(0.25, 0.6)))


def hex_color(text: str) -> Vector:
    """Red, green, blue in 0..1 of a colour such as `#ad2323`."""
    return vector(int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
