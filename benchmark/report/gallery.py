"""Pictures of one track: which scenes are shown, and the pictures of all models on them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from benchmark.metrics.errors_by_type import ERROR_TYPES
from benchmark.report.analysis import Analysis, read_maps
from benchmark.report.observations import Objects, read_truth, scene_tables
from benchmark.report.pictures import box_corners, boxes_picture, depth_picture, label_picture, photograph, slot_colors
from benchmark.results.reconstructions import chosen_scenes, load_reconstruction, shown_images, subsampled
from datagen.inspect.preview import label_colors
from datagen.storage.reader import read_camera_poses

Image = tuple[int, int, int]
"""Scene, frame and view."""
Scores = Float64[np.ndarray, "scene"]


@dataclass(frozen=True)
class Limits:
    """Numbers of pictures, which determine the size of a report."""

    worst: int
    """Scenes of each model."""
    pairs: int
    """Scenes of each pair of models."""
    paired: int
    """Models among which pairs are formed, the best first."""
    clips: int


LIMITS = (Limits(6, 4, 40, 4), Limits(6, 3, 16, 4), Limits(4, 2, 12, 3), Limits(3, 1, 8, 2), Limits(1, 0, 0, 1))
"""Sizes of the gallery, from generous to frugal; the first with which the page is small enough is used."""


@dataclass(frozen=True)
class Card:
    """One image of the gallery, and the models whose label maps are shown beside it."""

    image: Image
    models: tuple[int, ...]


def worst_scenes(scores: Scores, count: int) -> list[int]:
    """Select the scenes of lowest score, worst first; scenes without a score are left out."""
    return [int(i) for i in np.argsort(scores, kind="stable")[:count] if np.isfinite(scores[i])]


def disagreements(a: Scores, b: Scores, count: int) -> list[int]:
    """Select the scenes on which two models' scores differ most; scenes with equal scores are left out."""
    gaps = np.nan_to_num(np.abs(a - b), nan=0.0)
    return [int(i) for i in np.argsort(-gaps, kind="stable")[:count] if gaps[i] > 0]


def typical_scenes(scores: Sequence[Scores], count: int, among: Sequence[int]) -> list[int]:
    """Select the scene of median difficulty among some by all models' mean, then the hardest of these."""
    stacked = np.stack(scores)[:, among]
    defined = np.isfinite(stacked).sum(axis=0)
    means = np.where(defined > 0, np.nansum(stacked, axis=0) / np.maximum(defined, 1), np.nan)
    order = worst_scenes(means, len(means))
    return [among[i] for i in dict.fromkeys([order[len(order) // 2], *order])][:count] if order else []


def telling_image(objects: Objects, scene: int, values: Float64[np.ndarray, "observation"]) -> Image:
    """Select the image of a scene whose objects have the largest mean value."""
    inside = np.flatnonzero(objects.scene == scene)
    places, members = np.unique(np.column_stack([objects.frame, objects.view])[inside], axis=0, return_inverse=True)
    members = members.ravel()
    means = np.bincount(members, values[inside]) / np.bincount(members)
    frame, view = places[int(np.argmax(np.round(means, 9)))]
    return scene, int(frame), int(view)


def errors_in_words(objects: Objects, image: Image, errors: Float64[np.ndarray, "observation type"]) -> str:
    """Count the errors of one run in one image, such as `2 merged, 1 missed`."""
    scene, frame, view = image
    inside = (objects.scene == scene) & (objects.frame == frame) & (objects.view == view)
    counts = zip(ERROR_TYPES, errors[inside].sum(axis=0), strict=True)
    return ", ".join(f"{round(float(count))} {name}" for name, count in counts if count >= 0.5) or "no error"


def choose_cards(
    analysis: Analysis, limits: Limits, best_first: Sequence[int]
) -> tuple[dict[int, list[Card]], dict[tuple[int, int], list[Card]]]:
    """Choose the worst scenes of every model, and the largest disagreements between the best models."""
    objects, outcomes, scores = analysis.objects, analysis.outcomes, analysis.scores
    bad = {
        model: [
            Card(telling_image(objects, scene, -outcomes[model].overlap), (model,))
            for scene in worst_scenes(scores[model], limits.worst)
        ]
        for model in scores
    }
    apart = {
        (a, b): [
            Card(_most_apart(objects, scene, outcomes[a].overlap - outcomes[b].overlap), (a, b))
            for scene in disagreements(scores[a], scores[b], limits.pairs)
        ]
        for a, b in combinations(sorted(best_first[: limits.paired]), 2)
    }
    return bad, apart


def _most_apart(objects: Objects, scene: int, difference: np.ndarray) -> Image:
    """Select the image whose mean difference is largest in the direction in which the whole scene differs."""
    inside = difference[objects.scene == scene]
    return telling_image(objects, scene, difference if inside.sum() >= 0 else -difference)


def corners_in_images(
    boxes: tuple[np.ndarray, np.ndarray, np.ndarray],
    k: Float64[np.ndarray, "view 3 3"],
    cameras: Float64[np.ndarray, "frame view 4 4"],
    images: Sequence[tuple[int, int]],
) -> list[np.ndarray]:
    """Project the boxes of `Maps.boxes` into images, given as frame and view."""
    center, rotation, size = boxes
    return [box_corners(center[i], rotation[i], size[i], k[i[1]], cameras[i]) for i in images]


class Album:
    """Pictures of the whole page; each is drawn and stored once."""

    def __init__(self) -> None:
        self.uris: list[str] = []
        self._places: dict[tuple[Any, ...], int] = {}

    def place(self, key: tuple[Any, ...], draw: Callable[[], str]) -> int:
        """Return the number of the picture with that key, which is drawn if it is new."""
        if key not in self._places:
            self._places[key] = len(self.uris)
            self.uris.append(draw())
        return self._places[key]


class Painter:
    """Draws the pictures of one track into the page's album."""

    def __init__(self, folder: Path, analysis: Analysis, album: Album, best_first: Sequence[int], limits: Limits):
        self._analysis, self._album = analysis, album
        self._worst, self._pairs = choose_cards(analysis, limits, best_first)
        among = chosen_scenes(folder, list(analysis.rows.values()), len(analysis.scenes))
        self._clips = typical_scenes(list(analysis.scores.values()), limits.clips, among)
        self._reconstructions = self._load_reconstructions(folder)
        self._maps = {model: read_maps(folder, row, self._wanted(model)) for model, row in analysis.rows.items()}
        self._records: dict[int, Mapping[str, np.ndarray]] = {}
        self._colors: dict[tuple[int, int], UInt8[np.ndarray, "slot 3"]] = {}

    def _load_reconstructions(self, folder: Path) -> dict[int, dict[int, UInt8[np.ndarray, "image height width 3"]]]:
        """Load the reconstructions of the clips, of the models that have them all."""
        count = len(shown_images(*self._analysis.scenes.labels_shape[1:3]))
        found = {}
        for model, row in self._analysis.rows.items():
            images = {scene: load_reconstruction(folder, row, scene, count) for scene in self._clips}
            there = {scene: strip for scene, strip in images.items() if strip is not None}
            if there and len(there) == len(self._clips):
                found[model] = there
        return found

    def _wanted(self, model: int) -> set[int]:
        lists = [*self._worst.values(), *self._pairs.values()]
        return set(self._clips) | {card.image[0] for cards in lists for card in cards if model in card.models}

    def gallery(self, best_first: Sequence[int]) -> dict[str, Any]:
        """Describe all pictures for the page's script; those of clips with the models in this order."""
        return {
            "choice": self._choice,
            "worst": {str(model): [self._card(card) for card in cards] for model, cards in self._worst.items()},
            "pairs": {f"{a},{b}": [self._card(card) for card in cards] for (a, b), cards in self._pairs.items()},
            "clips": [self._clip(scene, best_first) for scene in self._clips],
        }

    @property
    def _choice(self) -> str:
        """Explain which scenes are shown as clips."""
        words = " with reconstructions" if self._reconstructions else ""
        return f"Test scenes{words}: of median difficulty, then the hardest."

    def _card(self, card: Card) -> dict[str, Any]:
        scene, frame, view = card.image
        frames, views = self._record(scene)["rgb"].shape[:2]
        where = [f"frame {frame}"] if frames > 1 else []
        where += [f"view {view}"] if views > 1 or frames == 1 else []
        images = [(frame, view)]
        maps = []
        for model in card.models:
            words = errors_in_words(self._analysis.objects, card.image, self._analysis.outcomes[model].errors)
            maps.append([model, self._prediction(model, scene, images), self._score(model, scene), words])
        rgb, truth = self._photograph(scene, images), self._truth(scene, images)
        return {"scene": scene, "where": ", ".join(where), "rgb": rgb, "truth": truth, "maps": maps}

    def _clip(self, scene: int, best_first: Sequence[int]) -> dict[str, Any]:
        """Describe the clip of a scene: RGB, depth and ground truth; labels, boxes and reconstructions of models."""
        rgb = self._record(scene)["rgb"]
        chosen = shown_images(*rgb.shape[:2])
        height, width = subsampled(rgb[0, 0]).shape[:2]
        layers = [
            {"name": "RGB", "picture": self._photograph(scene, chosen), "photo": True},
            {"name": "ground truth", "picture": self._truth(scene, chosen)},
            {"name": "depth", "picture": self._depth(scene, chosen), "photo": True},
        ]
        for model in best_first:
            shown = {"model": model, "score": self._score(model, scene)}
            layers.append({**shown, "picture": self._prediction(model, scene, chosen)})
            if self._maps[model][scene].boxes is not None:
                picture = self._boxes(model, scene, chosen)
                layers.append({**shown, "picture": picture, "part": "boxes", "photo": True})
            if model in self._reconstructions:
                picture = self._reconstruction(model, scene, chosen)
                layers.append({**shown, "picture": picture, "part": "reconstruction", "photo": True})
        return {"scene": scene, "count": len(chosen), "ratio": round(width / height, 3), "layers": layers}

    def _score(self, model: int, scene: int) -> str:
        return f"{self._analysis.scores[model][scene]:z.3f}"

    def _record(self, scene: int) -> Mapping[str, np.ndarray]:
        if scene not in self._records:
            fields = ["rgb", "depth", "segmentation", "camera/K"]
            self._records[scene] = self._analysis.scenes.read(scene, fields)
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
        labels, colors = self._maps[model][scene].labels, self._slot_colors(model, scene)
        name = f"prediction {self._analysis.rows[model].key.name}"
        return self._place(name, scene, images, lambda: label_picture([labels[i] for i in images], colors))

    def _boxes(self, model: int, scene: int, images: list[tuple[int, int]]) -> int:
        record, poses = self._record(scene), self._maps[model][scene].boxes
        assert poses is not None
        corners = corners_in_images(poses, record["camera/K"], read_camera_poses(self._analysis.scenes, scene), images)
        name, colors = f"boxes {self._analysis.rows[model].key.name}", self._slot_colors(model, scene)
        return self._place(
            name, scene, images, lambda: boxes_picture([record["rgb"][image] for image in images], corners, colors)
        )

    def _reconstruction(self, model: int, scene: int, images: list[tuple[int, int]]) -> int:
        pictures = self._reconstructions[model][scene]
        name = f"reconstruction {self._analysis.rows[model].key.name}"
        return self._place(name, scene, images, lambda: photograph([*pictures]))

    def _slot_colors(self, model: int, scene: int) -> UInt8[np.ndarray, "slot 3"]:
        if (model, scene) not in self._colors:
            maps = self._maps[model][scene]
            tables = scene_tables(*read_truth(self._analysis.scenes, scene), maps.labels, maps.background_slot)
            self._colors[model, scene] = slot_colors(tables.reshape(-1, *tables.shape[2:]), maps.background_slot)
        return self._colors[model, scene]

    def _place(self, layer: str, scene: int, images: list[tuple[int, int]], draw: Callable[[], str]) -> int:
        return self._album.place((str(self._analysis.scenes.folder), layer, scene, *images), draw)
