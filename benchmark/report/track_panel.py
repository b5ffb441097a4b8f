"""Everything that the report shows of one track under one way of fitting, ready for the template."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from benchmark.report.analysis import Analysis, Maps, choose_cards, choose_clips, read_maps
from benchmark.report.charts import LineChart, class_chart
from benchmark.report.gallery import Card, errors_in_words
from benchmark.report.observations import read_truth, scene_tables
from benchmark.report.pictures import depth_picture, label_picture, photograph, slot_colors
from benchmark.report.slices import Missing, slicings
from datagen.inspect.preview import label_colors

MOST_IMAGES = 8
"""Images of a clip's strip; longer clips are sampled evenly."""

Key = tuple[Any, ...]


@dataclass(frozen=True)
class Limits:
    """How many pictures a report holds, which decides about its size."""

    worst: int
    """Scenes of each model."""
    pairs: int
    """Scenes of each pair of models."""
    paired: int
    """Models of a track among which pairs are formed, the best first."""
    clips: int


LIMITS = (Limits(6, 4, 40, 2), Limits(6, 3, 16, 2), Limits(4, 2, 12, 2), Limits(3, 1, 8, 1), Limits(1, 0, 0, 1))
"""From generous to frugal: the first that fits is taken."""


class Album:
    """Pictures of the whole page; each is drawn and kept once."""

    def __init__(self) -> None:
        self.uris: list[str] = []
        self._places: dict[Key, int] = {}

    def place(self, key: Key, draw: Callable[[], str]) -> int:
        """Number of the picture of that key, which is drawn if it is new."""
        if key not in self._places:
            self._places[key] = len(self.uris)
            self.uris.append(draw())
        return self._places[key]


def slice_charts(analysis: Analysis) -> list[LineChart | Missing]:
    """One chart for each slicing, with a curve for each model."""
    charts: list[LineChart | Missing] = []
    for slicing in slicings(analysis.objects):
        if isinstance(slicing, Missing):
            charts.append(slicing)
            continue
        curves = {model: slicing.means(outcome.overlap).tolist() for model, outcome in analysis.means.items()}
        charts.append(class_chart(slicing.title, slicing.axis, slicing.names, slicing.counts.tolist(), curves))
    return charts


def error_shares(analysis: Analysis) -> dict[int, list[float]]:
    """Share of all objects in all images that suffer each type of error, by model."""
    return {model: outcome.errors.mean(axis=0).tolist() for model, outcome in analysis.means.items()}


class Painter:
    """Draws the pictures of one analysis into the page's album."""

    def __init__(self, folder: Path, analysis: Analysis, album: Album, ranked: Sequence[int], limits: Limits):
        self._analysis, self._album = analysis, album
        self._worst, self._pairs = choose_cards(
            analysis, worst=limits.worst, pairs=limits.pairs, paired=ranked[: limits.paired]
        )
        self._clips = choose_clips(analysis, limits.clips)
        self._maps = {model: read_maps(folder, analysis.rows[model], self._wanted(model)) for model in analysis.rows}
        self._records: dict[int, Mapping[str, np.ndarray]] = {}
        self._colors: dict[tuple[int, int], UInt8[np.ndarray, "slot 3"]] = {}

    def _wanted(self, model: int) -> set[int]:
        lists = [*self._worst.values(), *self._pairs.values()]
        return set(self._clips) | {card.image[0] for cards in lists for card in cards if model in card.models}

    def gallery(self) -> dict[str, dict[str, list[dict[str, Any]]]]:
        """The cards, for the page's script."""
        return {
            "worst": {str(model): [self._card(card) for card in cards] for model, cards in self._worst.items()},
            "pairs": {f"{a},{b}": [self._card(card) for card in cards] for (a, b), cards in self._pairs.items()},
        }

    def clips(self, names: Sequence[str], failed: Mapping[int, str]) -> list[dict[str, Any]]:
        """Strips of RGB, depth, truth and every model; models that failed stand there with the reason."""
        return [self._clip(scene, names, failed) for scene in self._clips]

    def _card(self, card: Card) -> dict[str, Any]:
        scene, frame, view = card.image
        record = self._record(scene)
        frames, views = record["rgb"].shape[:2]
        where = [f"frame {frame}"] if frames > 1 else []
        where += [f"view {view}"] if views > 1 or frames == 1 else []
        images = [(frame, view)]
        maps = []
        for model in card.models:
            words = errors_in_words(self._analysis.objects, card.image, self._analysis.outcomes[model].errors)
            score = f"{self._analysis.scores[model][scene]:z.3f}"
            maps.append([model, self._prediction(model, scene, images), score, words])
        rgb, truth = self._photograph(scene, images), self._truth(scene, images)
        return {"scene": scene, "where": ", ".join(where), "rgb": rgb, "truth": truth, "maps": maps}

    def _clip(self, scene: int, names: Sequence[str], failed: Mapping[int, str]) -> dict[str, Any]:
        frames, views = self._record(scene)["rgb"].shape[:2]
        images = [(frame, view) for frame in range(frames) for view in range(views)]
        chosen = [images[i] for i in _spread(len(images), MOST_IMAGES)]
        marks = [f"{frame}" if views == 1 else f"view {view}" for frame, view in chosen]
        rows = [
            _strip_row("image", self._photograph(scene, chosen), photo=True),
            _strip_row("depth", self._depth(scene, chosen), photo=True),
            _strip_row("truth", self._truth(scene, chosen)),
        ]
        for model, scores in self._analysis.scores.items():
            words = f"MSC-FG {scores[scene]:z.3f}"
            rows.append(_strip_row(names[model], self._prediction(model, scene, chosen), model=model, words=words))
        rows += [_strip_row(names[model], None, model=model, reason=why) for model, why in failed.items()]
        return {"scene": scene, "marks": marks, "rows": rows}

    def _record(self, scene: int) -> Mapping[str, np.ndarray]:
        if scene not in self._records:
            self._records[scene] = self._analysis.scenes.read(scene, ["rgb", "depth", "segmentation"])
        return self._records[scene]

    def _photograph(self, scene: int, images: list[tuple[int, int]]) -> int:
        rgb = self._record(scene)["rgb"]
        return self._place("rgb", scene, images, lambda: photograph([rgb[image] for image in images]))

    def _depth(self, scene: int, images: list[tuple[int, int]]) -> int:
        depth = self._record(scene)["depth"]
        seen = depth[depth > 0]
        near, far = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
        return self._place("depth", scene, images, lambda: depth_picture([depth[i] for i in images], near, far))

    def _truth(self, scene: int, images: list[tuple[int, int]]) -> int:
        truth = self._record(scene)["segmentation"]
        colors = label_colors(int(truth.max()) + 1)
        return self._place("truth", scene, images, lambda: label_picture([truth[i] for i in images], colors))

    def _prediction(self, model: int, scene: int, images: list[tuple[int, int]]) -> int:
        labels, slot = self._maps[model][scene]
        name = f"prediction {self._analysis.rows[model].key.name}"
        colors = self._slot_colors(model, scene, (labels, slot))
        return self._place(name, scene, images, lambda: label_picture([labels[i] for i in images], colors))

    def _slot_colors(self, model: int, scene: int, maps: Maps) -> UInt8[np.ndarray, "slot 3"]:
        if (model, scene) not in self._colors:
            tables = scene_tables(*read_truth(self._analysis.scenes, scene), *maps)
            self._colors[model, scene] = slot_colors(tables.reshape(-1, *tables.shape[2:]), maps[1])
        return self._colors[model, scene]

    def _place(self, layer: str, scene: int, images: list[tuple[int, int]], draw: Callable[[], str]) -> int:
        return self._album.place((str(self._analysis.scenes.folder), layer, scene, *images), draw)


def shades(values: Sequence[float], strength: float = 0.55) -> list[dict[str, str]]:
    """Cells of a table whose ground grows darker with the value, 0 to 1."""
    return [
        {"text": f"{100 * v:.1f}%" if 0 < v < 1 else f"{100 * v:.0f}%", "shade": f"{strength * v:.3f}"} for v in values
    ]


def error_rows(analysis: Analysis) -> list[dict[str, Any]]:
    """The table of errors: one row a model."""
    return [{"model": model, "cells": shades(shares)} for model, shares in error_shares(analysis).items()]


def _strip_row(
    name: str, picture: int | None, *, model: int | None = None, photo: bool = False, words: str = "", reason: str = ""
) -> dict[str, Any]:
    return {"name": name, "picture": picture, "model": model, "photo": photo, "words": words, "reason": reason}


def _spread(length: int, count: int) -> list[int]:
    """At most `count` places in 0 to length - 1, evenly, with both ends."""
    if length <= count:
        return list(range(length))
    return [round(place * (length - 1) / (count - 1)) for place in range(count)]
