"""Dataset statistics that a model needs before training: point spacing, noise, and the extent of the workspace."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from datagen.rgbd.plane import fit_plane
from obpose.data.clips import ClipSource, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.types import Observation

CLIPS = 32
"""Number of clips whose first frame is measured, evenly spread over the source."""
TAIL = 0.01
"""Share of the points that may lie outside the workspace, at either end of each axis."""
MARGIN = 1.05
"""Factor by which the workspace is larger than the cube around the other points."""


@dataclass(frozen=True)
class SceneMeasures:
    """Statistics of the observed surfaces; they need no labels."""

    spacing: float
    """Median distance in metres between the surface points of neighbouring pixels."""
    workspace_center: tuple[float, float, float]
    """Centre of the cube that holds nearly all points, world frame, metres."""
    workspace_size: float
    """Edge of that cube, metres."""
    background_size: float
    """Edge of the cube with the same centre that holds all points and the cameras, metres."""
    noise: float
    """Median over the images of the standard deviation of the largest plane's points, metres; 0 without planes."""
    image_scale: int
    """Width of the images in units of 64 pixels, rounded; at least 1."""

    def changes(self) -> dict[str, Any]:
        """Give the statistics as configuration changes; `obpose.systems.System.known` selects those of a system."""
        return {f"{part}.{name}": value for part in ("model", "contact") for name, value in vars(self).items()}


def measure_scene(source: ClipSource) -> SceneMeasures:
    """Measure the first frames of up to `CLIPS` clips of a source.

    Raises:
        UsageError: there are no clips, no pixel has a depth, or the points are not finite.
    """
    if not len(source):
        raise UsageError("There are no training clips; expected a training split with at least one scene.")
    # Points of the first frames of clips that are evenly spread over the split.
    count = min(CLIPS, len(source))
    images = [observation_of([source.window(i * len(source) // count, 0, 1)]) for i in range(count)]
    clouds = [unproject(image)[image.valid] for image in images]
    points = torch.cat(clouds)
    steps = torch.cat([neighbour_distances(image) for image in images])
    if not len(points) or not len(steps):
        raise UsageError("The training clips show nothing: no neighbouring pixels with a depth in the first frames.")
    if not points.isfinite().all():
        raise UsageError(
            "The surface points of the training clips are not finite: their depths, camera matrices or poses hold NaN "
            "or infinity. obpose-datagen verify says where."
        )
    # Workspace without outliers, and the distance of cameras from its middle.
    low, high = _quantile(points, TAIL), _quantile(points, 1 - TAIL)
    middle = (low + high) / 2
    x, y, z = middle.tolist()
    cameras = torch.cat([image.world_from_camera[..., :3, 3].flatten(0, 1) for image in images])
    reach = (torch.cat([points, cameras]) - middle).abs().max()
    return SceneMeasures(
        spacing=float(steps.median()),
        workspace_center=(x, y, z),
        workspace_size=MARGIN * float((high - low).max()),
        background_size=2 * float(reach),
        noise=_plane_noise(clouds),
        image_scale=max(1, round(images[0].depth.shape[-1] / 64)),
    )


def _plane_noise(clouds: list[Float[Tensor, "_ 3"]]) -> float:
    planes = [fit_plane(cloud.double().numpy(), np.random.default_rng(0)) for cloud in clouds]
    spreads = [plane.spread for plane in planes if plane is not None]
    return float(np.median(spreads)) if spreads else 0.0


def neighbour_distances(image: Observation) -> Float[Tensor, " pair"]:
    """Distances in metres between horizontally or vertically neighbouring pixels that both have a depth."""
    points = rearrange(unproject(image), "b f v height width c -> (b f v) height width c")
    valid = rearrange(image.valid, "b f v height width -> (b f v) height width")
    across = (points[:, :, 1:] - points[:, :, :-1]).norm(dim=-1)[valid[:, :, 1:] & valid[:, :, :-1]]
    down = (points[:, 1:] - points[:, :-1]).norm(dim=-1)[valid[:, 1:] & valid[:, :-1]]
    return torch.cat([across, down])


def _quantile(points: Float[Tensor, "point 3"], share: float) -> Float[Tensor, "3"]:
    """Quantile along each axis by sorting, because `torch.quantile` refuses more than 16 million values."""
    place = round(share * (len(points) - 1))
    return points.sort(dim=0).values[place]
