"""Estimation of a scene's light from the shadows of its objects, without labels.

The dense voxels of the objects are projected onto the table along candidate directions, in several frames at once. The
best direction explains where the frames are darker than the scene's background. This needs good fields, so scenes are
fitted to their frames first (`obpose.scenes.refine`).
"""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import from_box
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.background_pixels import Shown, occlusion_where_shown, shown_background
from obpose.scenes.appearance.light import Light, no_light
from obpose.scenes.bounds import CELLS, occupied
from obpose.scenes.rendering import Renderer, object_codes
from obpose.scenes.scene import Scene
from obpose.types import Observation

LEAST_STRENGTH = 0.1
"""Least share of the background's colour that shadows take; weaker lights are not reported."""
LEAST_EXPLAINED = 0.02
"""Least share of the variance of the background's darkness that shadows explain."""
MOST_OVERHEAD = 0.8
"""Largest share of the explained variance that a light straight above may explain, because its shadows cannot be
distinguished from ambient occlusion at object bases."""
_WEIGHTS = (0.3, 0.6, 0.1)
"""Weights of red, green and blue in luminance."""
_DARK, _DARKEST, _BRIGHTEST = 0.02, -1.5, 0.3
"""Least luminance before the logarithm, and limits of its difference; larger differences are not shadows."""
_OPACITY = 0.3
"""Optical thickness of a voxel: low, because fields are larger than their objects."""
_ELEVATIONS, _AZIMUTHS = range(22, 86, 9), range(0, 360, 20)
_LOWEST, _HIGHEST = 15.0, 88.0
"""Range of elevations, degrees."""
_ROUNDS, _PART = 8, 4
"""Rounds of the local search around the best direction; the coarse grid uses every 4th pixel."""
_PIXELS = 4096
"""Number of pixels from which the strength is estimated."""


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Pixels that show the background, and dense voxels of the objects above the table; world frame, metres."""

    point: Float[Tensor, "pixel 3"]
    frame: Int[Tensor, " pixel"]
    darkness: Float[Tensor, " pixel"]
    """Log of the ratio of brightness in the frames and in the scene, minus its median."""
    voxel: Float[Tensor, "voxel 3"]
    voxel_frame: Int[Tensor, " voxel"]
    frames: int
    cell: float
    """Edge of a voxel, metres."""

    def part(self) -> "_Evidence":
        """Keep some of the pixels."""
        pixels = {name: getattr(self, name)[::_PART] for name in ("point", "frame", "darkness")}
        return replace(self, **pixels)

    def explained(self, toward: Float[Tensor, "3"]) -> float:
        """Compute the share of the variance of darkness that shadows from a direction explain; 0 if they are bright."""
        shadow, darkness = self.shadow(toward), self.darkness
        shadow, darkness = shadow - shadow.mean(), darkness - darkness.mean()
        common = float(shadow @ darkness)
        spread = float(shadow.square().sum() * darkness.square().sum())
        return common**2 / spread if common < 0 and spread > 0 else 0.0

    def shadow(self, toward: Float[Tensor, "3"]) -> Float[Tensor, " pixel"]:
        """Estimate the share of the light that voxels keep from the pixels, on a grid of the table."""
        # Both projected onto z = 0 along the direction of the light.
        receivers, blockers = (
            points[:, :2] - points[:, 2:] * (toward[:2] / toward[2]) for points in (self.point, self.voxel)
        )
        low = receivers.amin(dim=0)
        size = ((receivers.amax(dim=0) - low) / self.cell).long() + 1
        across, along = size.tolist()
        # Voxels above each cell, frame by frame.
        inside, at = _cell(blockers, low, self.cell, size)
        count = receivers.new_zeros(self.frames * across * along)
        count.index_add_(0, (self.voxel_frame * across * along + at)[inside], count.new_ones(int(inside.sum())))
        thickness = F.avg_pool2d(count.view(self.frames, 1, across, along), 3, stride=1, padding=1).flatten(1)
        _, at = _cell(receivers, low, self.cell, size)
        return -torch.expm1(-_OPACITY * thickness[self.frame, at])


@torch.no_grad()
def find_light(model: ObPose, observation: Observation, scene: Scene) -> Light:
    """Estimate the light from shadows in the frames; no light if there are hardly any.

    The result is deterministic. The cost is about that of twenty steps of refinement.

    The scene has no light yet; the observation is a batch of its clip.
    """
    shown = shown_background(model, observation, scene)
    voxel, voxel_frame = _voxels(model, scene)
    if not len(voxel) or not len(shown.point):
        return no_light(scene.center)
    # Difference of log brightness between frames and scene.
    ratio = _luminance(shown.seen).clamp(min=_DARK).log() - _luminance(shown.drawn).clamp(min=_DARK).log()
    darkness = (ratio - ratio.median()).clamp(_DARKEST, _BRIGHTEST)
    cell = model.config.model.pose.box_size / CELLS
    evidence = _Evidence(shown.point, shown.frame, darkness, voxel, voxel_frame, scene.frames, cell)
    # The best direction, and how much better it is than a light straight above.
    toward, explained = _search(evidence)
    overhead = evidence.explained(_toward(0.0, 90.0))
    if explained < LEAST_EXPLAINED or overhead > MOST_OVERHEAD * explained:
        return no_light(scene.center)
    strength = _strength(Renderer(model), shown, scene, toward)
    return torch.cat([toward, toward.new_tensor([strength])]) if strength >= LEAST_STRENGTH else no_light(scene.center)


def _voxels(model: ObPose, scene: Scene) -> tuple[Float[Tensor, "voxel 3"], Int[Tensor, " voxel"]]:
    """Find the dense voxels of the objects above the table, and their frames."""
    points, owners, size, table = [], [], model.config.model.pose.box_size, model.config.model.table or 0.0
    for frame in range(scene.frames):
        for place in range(len(scene.ids)):
            codes = object_codes(model, scene, frame, place)
            pose = scene.center[frame, place], scene.rotation[frame, place]
            found = from_box(occupied(model, codes), *pose, size)
            found = found[found[:, 2] > table]
            points.append(found)
            owners.append(torch.full((len(found),), frame))
    if not points:
        return scene.center.new_zeros(0, 3), torch.zeros(0, dtype=torch.long)
    return torch.cat(points), torch.cat(owners)


def _search(whole: _Evidence) -> tuple[Float[Tensor, "3"], float]:
    """The best direction, and the share of the variance that its shadows explain: coarse, then around the best."""
    # Coarse grid, judged on some of the pixels.
    part = whole.part()
    grid = [(float(azimuth), float(elevation)) for elevation in _ELEVATIONS for azimuth in _AZIMUTHS]
    best = max(grid, key=lambda angles: part.explained(_toward(*angles)))
    explained = whole.explained(_toward(*best))
    # Pattern search around the best one, on all pixels.
    across, up = _AZIMUTHS.step / 2, _ELEVATIONS.step / 2
    for _ in range(_ROUNDS):
        azimuth, elevation = best
        higher, lower = min(_HIGHEST, elevation + up), max(_LOWEST, elevation - up)
        around = [(azimuth - across, elevation), (azimuth + across, elevation), (azimuth, higher), (azimuth, lower)]
        scores = [whole.explained(_toward(*angles)) for angles in around]
        if max(scores) > explained:
            explained = max(scores)
            best = around[scores.index(explained)]
        else:
            across, up = across / 2, up / 2
    return _toward(*best), explained


def _toward(azimuth: float, elevation: float) -> Float[Tensor, "3"]:
    """Give the direction of an azimuth and an elevation in degrees."""
    turn, rise = math.radians(azimuth), math.radians(elevation)
    return torch.tensor([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise)])


def _luminance(colour: Float[Tensor, "pixel 3"]) -> Float[Tensor, " pixel"]:
    return colour @ colour.new_tensor(_WEIGHTS)


def _cell(
    places: Float[Tensor, "point 2"], low: Float[Tensor, "2"], cell: float, size: Int[Tensor, "2"]
) -> tuple[Bool[Tensor, " point"], Int[Tensor, " point"]]:
    """Give for each place whether it is on the grid, and the index of its cell."""
    at = ((places - low) / cell).floor().long()
    return ((at >= 0) & (at < size)).all(dim=-1), at[:, 0] * size[1] + at[:, 1]


def _strength(renderer: Renderer, shown: Shown, scene: Scene, toward: Float[Tensor, "3"]) -> float:
    """Fit the share of the background's colour that rendered shadows take, by least squares; 0..1.

    A common factor of brightness between frames and scene is fitted too, and ignored.
    """
    shown = shown.at(slice(None, None, max(1, len(shown.point) // _PIXELS)))
    occluded = occlusion_where_shown(renderer, scene, shown, toward)
    drawn, seen = _luminance(shown.drawn), _luminance(shown.seen)
    parts = torch.stack([drawn, -drawn * occluded], dim=-1)
    products = parts.T @ parts + 1e-6 * torch.eye(2)
    level, lost = torch.linalg.solve(products, parts.T @ seen).tolist()
    return min(1.0, max(0.0, lost / max(level, 1e-6)))
