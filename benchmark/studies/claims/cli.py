"""The paper's own claims, measured: voxel estimate, object frames, figures 1 and 2.

python -m benchmark.studies.claims.cli                                     with the weights that ship
python -m benchmark.studies.claims.cli --checkpoint none=DIR location=DIR full=DIR
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from statistics import mean, median

import torch

from benchmark.studies.claims.command import run_command
from benchmark.studies.claims.figures import appearances, voxels_and_poses
from benchmark.studies.claims.frames import FRAMINGS, Framing, code_spread, codes_of, variance
from benchmark.studies.claims.scenes import Account, Found, Scene, account, read_scenes
from benchmark.studies.claims.shapes import FINE, estimate_voxels, measure_times, shape_errors
from datagen.errors import EXIT_OK, UsageError
from datagen.tracks import DataFolder, Track, find_track
from obpose.model.obpose import ObPose
from obpose.storage.checkpoint import load_obpose
from obpose.storage.pretrained import find_shipped
from obpose.training.devices import keep_memory

PROGRAM = "python -m benchmark.studies.claims.cli"
SPLIT = "val"


@dataclass(frozen=True)
class Arguments:
    """Options of the command."""

    checkpoint: tuple[str, ...] = ()
    """Folders of models by their conditioning: none=DIR location=DIR full=DIR. Without `full` it is the shipped one.
    Where a conditioning has no model the fields of `full` are looked at in such frames."""
    track: str = "moving"
    """Track to look at."""
    data: Path | None = None
    """A dataset folder in the track's place."""
    scenes: int = 20
    """How many validation scenes are measured."""
    figure_scenes: tuple[int, int] = (7, 0)
    """Which of them figures 1 and 2 show."""
    out: Path = Path("docs/images")
    """Folder for the pictures."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and draw; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Look at the scenes with every model."""
    if not all(0 <= scene < values.scenes for scene in values.figure_scenes):
        raise UsageError(f"--figure-scenes {values.figure_scenes}: expected two of the {values.scenes} scenes, from 0.")
    torch.set_num_threads(1)
    keep_memory()
    data = DataFolder(values.data) if values.data is not None else find_track(values.track)
    models = _models(values, data)
    scenes = list(read_scenes(data.prepare((SPLIT,)), SPLIT, values.scenes))
    accounts: dict[Framing, Sequence[Account]] = {
        framing: [account(model, scene) for scene in scenes] for framing, model in models.items()
    }
    _print_shapes(accounts["full"])
    _print_frames(accounts)
    _draw(accounts, values)
    return EXIT_OK


def _models(values: Arguments, data: Track | DataFolder) -> dict[Framing, ObPose]:
    folders = dict(_folder(text) for text in values.checkpoint)
    if "full" not in folders:
        folders["full"] = find_shipped("obpose", data.name, data.resolution)
    models: dict[Framing, ObPose] = {}
    for framing, folder in folders.items():
        model = load_obpose(folder)
        if (conditioning := model.config.model.pose.conditioning) != framing:
            raise UsageError(
                f"{folder} was trained with conditioning {conditioning!r}, expected {framing!r}; name it after that."
            )
        models[framing] = model
    return models


def _folder(text: str) -> tuple[Framing, Path]:
    name, _, folder = text.partition("=")
    for framing in FRAMINGS:
        if name == framing and folder:
            return framing, Path(folder)
    raise UsageError(f"--checkpoint {text}: expected {', '.join(f'{framing}=DIR' for framing in FRAMINGS)}.")


def _print_shapes(accounts: Sequence[Account]) -> None:
    """The voxel estimate against the generator's truth and against volume rendering."""
    errors = [error for account in accounts for error in shape_errors(account)]
    objects = sum(account.scene.truth.count for account in accounts)
    followed = sum(len(account.found) for account in accounts)
    print(f"{followed} of {objects} objects of {len(accounts)} scenes are followed by a slot, in {len(errors)} frames.")
    if not errors:
        return
    size = accounts[0].model.config.model.voxels
    print(f"\n| median over these | with S = {size} | with S = {FINE} |\n|---|---|---|")
    print(f"| IoU of the voxels | {median(e.iou for e in errors):.2f} | {median(e.fine_iou for e in errors):.2f} |")
    print(
        "\n| distance from the middle of the object's bounding box | median | mean | nothing found |\n|---|---|---|---|"
    )
    for name, distances in (
        ("T_shape, middle of the voxels", [error.voxels for error in errors]),
        ("T_hat, predicted", [error.predicted for error in errors]),
        ("T, mean of the observed points", [error.observed for error in errors]),
        ("middle of the rendered surface", [error.rendered for error in errors]),
    ):
        known = [1000 * distance for distance in distances if isfinite(distance)]
        found = f"{median(known):.1f} mm | {mean(known):.1f} mm" if known else " | "
        print(f"| {name} | {found} | {len(errors) - len(known)} |")
    times = measure_times(accounts[0])
    print(
        f"\nA clip takes {1000 * times.voxels:.0f} ms of CPU time by voxels, {1000 * times.rendering:.0f} ms by "
        f"rendering ({times.rendering / times.voxels:.0f} times as long), {1000 * times.objects_alone:.0f} ms by "
        f"rendering the objects' densities alone ({times.objects_alone / times.voxels:.0f} times)."
    )


def _print_frames(accounts: Mapping[Framing, Sequence[Account]]) -> None:
    """The claim behind figure 2, as numbers."""
    print(
        "\n| objects that | frames | model | objects | variance of the truth | if centred | of the field | of z_what |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for motion, moves in {"move": Scene.moves, "turn": Scene.turns}.items():
        for framing in FRAMINGS:
            own = framing in accounts
            chosen = [
                (account, found)
                for account in accounts[framing if own else "full"]
                for found in account.found
                if moves(account.scene, found.row, found.frames)
            ]
            if not chosen:
                continue
            variances = [variance(account, found, framing) for account, found in chosen]
            columns = ([getattr(v, name) for v in variances] for name in ("truth", "centred", "model"))
            means = " | ".join(f"{_mean(column):.3f}" for column in columns)
            codes = f"{code_spread([codes_of(*pair) for pair in chosen]):.3f}" if own else ""
            print(f"| {motion} | {framing} | {framing if own else 'full'} | {len(chosen)} | {means} | {codes} |")


def _mean(values: Iterable[float]) -> float:
    """Of those that there are."""
    known = [value for value in values if isfinite(value)]
    return mean(known) if known else nan


def _draw(accounts: Mapping[Framing, Sequence[Account]], values: Arguments) -> None:
    values.out.mkdir(parents=True, exist_ok=True)
    one, two = values.figure_scenes
    posed = accounts["full"][one]
    turning = _turning_most({framing: accounts.get(framing, accounts["full"])[two] for framing in FRAMINGS})
    for name, picture in {
        "voxels_and_poses.png": voxels_and_poses(posed, estimate_voxels(posed, FINE)),
        "object_frames.png": appearances(turning, resolution=FINE),
    }.items():
        picture.save(values.out / name, optimize=True)
        print(values.out / name)


def _turning_most(accounts: Mapping[Framing, Account]) -> dict[Framing, tuple[Account, Found]]:
    """The object that turns most among those that all models follow, in the frames where they all do."""
    scene = accounts["full"].scene
    followers = [{found.row: found for found in accounts[framing].found} for framing in FRAMINGS]
    together: dict[int, list[int]] = {}
    for row in set.intersection(*map(set, followers)):
        if frames := set.intersection(*(set(found[row].frames) for found in followers)):
            together[row] = sorted(frames)
    if not together:
        raise UsageError("No object of this scene is followed by a slot of every model; choose other --figure-scenes.")
    row = max(together, key=lambda row: scene.angles(row, together[row]).max())
    return {
        framing: (accounts[framing], replace(found[row], frames=together[row]))
        for framing, found in zip(FRAMINGS, followers, strict=True)
    }


if __name__ == "__main__":
    raise SystemExit(main())
