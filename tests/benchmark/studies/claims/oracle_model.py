"""Scenes whose account is right: labels and boxes are the generator's, slot k is object k."""

from dataclasses import replace
from pathlib import Path

import torch

from benchmark.studies.claims.scenes import Account, Scene, account, read_scenes
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.types import Boxes
from obpose.variants import make_config
from tests.worlds import generated


def dataset(folder: Path) -> Path:
    """One validation scene of three frames at 32x32."""
    generated.make(folder, {"val": 1})
    return folder


def untrained(conditioning: str = "full") -> ObPose:
    torch.manual_seed(0)
    model = {"model.pose.conditioning": conditioning, "model.pose.box_size": 0.3, "model.workspace_size": 1.0}
    # All slots are in use, though a fresh pre-scope expects no object anywhere.
    return build_obpose(make_config(**model, **{"model.attention.inactive_points": 0})).eval()


def true_account(scene: Scene) -> Account:
    told = account(untrained(), scene)
    poses = torch.from_numpy(scene.truth.world_from_object).float()
    poses = torch.cat([poses, torch.eye(4).expand(len(poses), 4 - scene.truth.count, 4, 4)], dim=1)[None]
    inference = replace(
        told.segmentation.inference,
        boxes=Boxes(poses[..., :3, 3], poses[..., :3, :3], 0.3),
        observed_center=poses[..., :3, 3],
    )
    labels = torch.from_numpy(scene.truth.record["segmentation"]).long()[None]
    return replace(told, segmentation=replace(told.segmentation, labels=labels, inference=inference))


def only_scene(folder: Path) -> Scene:
    return next(read_scenes(folder, "val", 1))
