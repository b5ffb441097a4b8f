"""The systems of `obpose.systems` as models of the benchmark: clips to observations, labels and poses back."""

import copy
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float, UInt8

from benchmark.models.interface import RECONSTRUCTION_SIDE, Clip, Poses, Prediction
from benchmark.models.model_spec import settings_of
from benchmark.models.validation import ValidationScorer
from datagen.errors import UsageError
from obpose.config import override
from obpose.data.clips import ArrayClips, LabelledArrayClips, observation_of, select_part, separate_views
from obpose.data.scene_stats import measure_scene
from obpose.geometry import sides_of_points, unproject
from obpose.model.obpose import ObPose
from obpose.model.resolution import fitting_model
from obpose.pictures import to_bytes
from obpose.rgbd.weights import look_for
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.rendering import Renderer
from obpose.storage.checkpoint import load
from obpose.systems import build_model, find_system, slots_for
from obpose.trainable import Trainable
from obpose.training.devices import keep_memory
from obpose.training.loop import CurvePoint, train
from obpose.types import Observation, SceneSegmentation, Segmentation


class LearnedSegmenter:
    """One of `obpose.systems.SYSTEMS`, trained on clips or loaded from a checkpoint; implements `Segmenter`."""

    parameters: int = 0
    device: str = "cpu"
    learning_curve: list[dict[str, float]] | None = None
    fit_seconds: float = float("nan")
    """Training time on the budget's clock, in seconds; includes the time before an interruption."""
    config: Any = None
    """Configuration of the training that made the weights."""
    fitted_settings: Mapping[str, Any] | None = None
    """Settings of the training that made the weights, budget and scene included, in the format of `settings_of`."""

    def __init__(
        self,
        system: str,
        *,
        slots: int,
        steps: int | None = None,
        folder: Path | None = None,
        checkpoint: Path | None = None,
        profile: str = "cpu",
        changes: Mapping[str, Any] | None = None,
        watch: ValidationScorer | None = None,
    ):
        """Set options as in `benchmark.models.interface`; `slots` counts the background."""
        self._system, self._folder, self._checkpoint = find_system(system), folder, checkpoint
        self._changes = {**self._system.known(slots_for(slots)), "train.steps": steps, **(changes or {})}
        self._profile, self._watch = profile, watch

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Train for `budget` seconds of one core, or resume the training in the folder."""
        torch.set_num_threads(1)
        keep_memory()
        if self._checkpoint:
            self._model, self.config, _ = load(self._checkpoint)
            self._views, self.fitted_settings = self.config.train.views, settings_of(self.config)
        else:
            self._model = self._train(train, val, seed=seed, budget=budget)
        self.parameters = sum(parameter.numel() for parameter in self._model.parameters())

    def segment(self, clip: Clip) -> Prediction:
        """Segment a clip. Slot 0 is the background if the model has one; `extra` holds `Segmentation.attention`.

        Poses are included if the model gives objects poses and segments each view separately.
        """
        return self._segment(self._model, clip)

    def reconstruct_images(
        self, clip: Clip, images: Sequence[tuple[int, int]]
    ) -> UInt8[np.ndarray, "image rows columns 3"] | None:
        """Render the inferred scenes, as `segment` infers them; None if the model's objects have no poses."""
        if not isinstance(self._model, ObPose) or self._model.where is None or self._model.background is None:
            return None
        origin = Origin(copy.deepcopy(self._model).cpu(), Path(), "", "")
        renderer, observation = Renderer(origin.model), _observation(clip)
        views = range(clip.depth.shape[1])
        parts = [slice(None)] if self._views == "all" else [slice(view, view + 1) for view in views]
        scenes = [infer_scene(origin, select_part(observation, views=part)) for part in parts]
        cameras = [(scene, camera) for scene in scenes for camera in scene.cameras]
        rendered = []
        for frame, view in images:
            scene, camera = cameras[view]
            scale = min(1.0, RECONSTRUCTION_SIDE / max(camera.width, camera.height))
            camera = camera.resized(round(scale * camera.width), round(scale * camera.height))
            rendered.append(to_bytes(renderer.render(scene, frame, camera, antialiased=False).rgb))
        return np.stack(rendered)

    def with_changes(self, changes: Mapping[str, Any]) -> "LearnedSegmenter":
        """Copy this segmenter; the copy has the same weights and other values of settings, by dotted name.

        Raises:
            KeyError: the configuration has no such name.
        """
        other = copy.copy(self)
        other.config = override(self.config, dict(changes))
        other.fitted_settings = settings_of(other.config)
        with torch.random.fork_rng(devices=[]):
            other._model = build_model(other.config).to(device_of(self._model))
        other._model.load_state_dict(self._model.state_dict())
        other._model.eval()
        return other

    def looking_for(self, objects: int) -> "LearnedSegmenter":
        """Copy this segmenter; the copy looks for the given number of objects if its number of slots can be changed."""
        other = copy.copy(self)
        other._model = copy.deepcopy(self._model)
        look_for(other._model, objects)
        return other

    def _segment(self, model: Trainable, clip: Clip) -> Prediction:
        observation = _observation(clip).to(device_of(model))
        model = fitting_model(model, observation) if isinstance(model, ObPose) else model
        if self._views == "all":
            found, axes = model.segment(observation), "1 frame view h w -> frame view h w"
            poses = None
        else:
            apart = separate_views(observation)
            found, axes = model.segment(apart), "view frame 1 h w -> frame view h w"
            poses = poses_of(model, found, apart)
        labels, attention = (rearrange(maps, axes).cpu().numpy() for maps in (found.labels, found.attention))
        extra = dict.fromkeys(self._system.extra, attention)
        return Prediction(labels, model.background_slot, extra, poses)

    def _train(self, clips: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> Trainable:
        if not len(clips):
            raise UsageError(
                "The dataset has no training scenes; expected some to learn from. Generate some with --split train=N, "
                "or use weights with --pretrained or --checkpoint."
            )
        kind = LabelledArrayClips if self._system.uses_labels else ArrayClips
        source, validation = kind(clips), kind(val) if len(val) else None
        self.config = config = self._config(source, seed, budget)
        self._views, self.fitted_settings = config.train.views, settings_of(config)
        trained = train(source, validation, config, folder=self._folder, look=self._look)
        self.learning_curve = [_point(point) for point in trained.curve]
        self.fit_seconds = trained.seconds
        return trained.model

    def _look(self, model: Trainable, step: int, seconds: float) -> None:
        if self._watch:
            self._watch(partial(self._segment, model), step=step, seconds=seconds)

    def _config(self, source: ArrayClips, seed: int, budget: float) -> Any:
        measured = self._system.known(measure_scene(source).changes())
        run = {"train.seed": seed, "train.minutes": budget / 60}
        return self._system.config(self._profile, {**self._changes, **run, **measured})


def _observation(clip: Clip) -> Observation:
    source = ArrayClips([clip])
    return observation_of([source.window(0, 0, source.frames_of_clip)])


def device_of(model: Trainable) -> torch.device:
    """Device that holds the model's weights."""
    return next(model.parameters()).device


def _point(point: CurvePoint) -> dict[str, float]:
    """Validation losses of a curve point. `benchmark.ranking.failed_seeds` looks for names that contain "loss"."""
    losses = {"loss" if name == "total" else f"{name} loss": value for name, value in point.losses.items()}
    return {"step": float(point.step), "seconds": point.seconds, **losses}


def poses_of(model: Trainable, found: Segmentation, observation: Observation) -> Poses | None:
    """Poses of the objects in a segmentation; None if the model has no poses. Label 0 is the background.

    Scenes of the batch are views of one clip. The center is T_hat, the rotation is R. The model's own boxes are cubes
    of one size, so boxes are measured: the smallest box, centred at T_hat and along R, around the label's surface
    points. Objects are thus assumed symmetric about T_hat.
    """
    if not isinstance(model, ObPose) or not isinstance(found, SceneSegmentation) or found.inference.where is None:
        return None
    boxes = found.inference.boxes
    sides = sides_of_points(unproject(observation), found.labels, boxes)
    there = sides.isfinite().all(dim=-1)
    values = (
        boxes.center.masked_fill(~there[..., None], torch.nan),
        boxes.rotation.masked_fill(~there[..., None, None], torch.nan),
        sides.masked_fill(~there[..., None], torch.nan),
    )
    return Poses(*(_with_background(value) for value in values))


def _with_background(
    values: Float[torch.Tensor, "view frame slot *shape"],
) -> Float[np.ndarray, "frame view label *shape"]:
    array = rearrange(values, "view frame ... -> frame view ...").double().cpu().numpy()
    return np.concatenate([np.full_like(array[:, :, :1], np.nan), array], axis=2)
