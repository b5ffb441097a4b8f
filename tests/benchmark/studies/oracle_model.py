"""A clip that is inferred without error: labels and boxes are the generator's, slot k is object k."""

import itertools
from dataclasses import replace
from pathlib import Path

import torch

from benchmark.studies.inputs import InferredClip, infer_clips
from datagen.pipeline.generate import generate
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.types import Boxes
from obpose.variants import make_config
from tests.worlds import generated

FRAMES = 5


def dataset(folder: Path) -> Path:
    """Write one validation scene of five frames at 32x32."""
    generate(folder, generated.recipe(frames=FRAMES), splits={"val": 1}, resolution=generated.RESOLUTION)
    return folder


def untrained(conditioning: str = "full") -> ObPose:
    torch.manual_seed(0)
    model = {"model.pose.conditioning": conditioning, "model.pose.box_size": 0.3, "model.workspace_size": 1.0}
    # All slots are in use, though a fresh pre-scope expects no object anywhere.
    return build_obpose(make_config(**model, **{"model.attention.inactive_points": 0})).eval()


def true_clip(folder: Path) -> InferredClip:
    clip = next(infer_clips(untrained(), folder, "val", 1))
    poses = torch.from_numpy(clip.truth.world_from_object).float()
    poses = torch.cat([poses, torch.eye(4).expand(len(poses), 4 - clip.truth.count, 4, 4)], dim=1)[None]
    inference = replace(
        clip.segmentation.inference,
        boxes=Boxes(poses[..., :3, 3], poses[..., :3, :3], 0.3),
        observed_center=poses[..., :3, 3],
    )
    return relabelled(clip, torch.from_numpy(clip.truth.record["segmentation"]).long()[None], inference=inference)


def relabelled(clip: InferredClip, labels: torch.Tensor, **changes: object) -> InferredClip:
    return replace(clip, segmentation=replace(clip.segmentation, labels=labels, **changes))


def printed_table(text: str) -> list[dict[str, str]]:
    """Cells of the last Markdown table in a text, one dictionary per line."""
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    start = max(index for index, cells in enumerate(lines) if {*cells} == {"---"})
    header = [cell.strip() for cell in lines[start - 1]]
    return [
        dict(zip(header, (cell.strip() for cell in cells), strict=True))
        for cells in itertools.islice(lines, start + 1, None)
    ]
