"""Models, trainings that can go on, priors and scenes."""

import shutil
import signal
from contextlib import suppress
from pathlib import Path

import assets
from datagen.errors import EXIT_INTERRUPTED
from tests.fuzz.worlds.group import MOVING, TINY, Group, Target, run


def build_models(world: Path) -> None:
    """A training that can go on, a model with its priors, a scene, and half of the learning of a flow."""
    from obpose.commands.train import main as train
    from obpose.scenes.model_ref import load_origin  # late, as PyTorch takes seconds to import
    from obpose.scenes.priors.interface import FitSettings
    from obpose.scenes.priors.train_flow import fit_flow

    run(f"obpose-datagen {MOVING} --split train=18,val=1,test=1 --out {world}/data")

    def stop(truth: object, labels: object) -> float:
        """Stop the training at its first validation, which is after the first step."""
        signal.raise_signal(signal.SIGTERM)
        return 0.5

    if train(CONTINUE.format(w=world).split()[1:], score=stop) != EXIT_INTERRUPTED:
        raise RuntimeError("The training was not interrupted.")
    run(f"obpose-train --data {world}/data --steps 1 --variant obsurf --out {world}/obsurf")
    shutil.copytree(assets.CHECKPOINTS / "obpose-contact--moving--64x64", world / "model")
    shutil.copytree(assets.CHECKPOINTS / "obpose-contact--moving--64x64", world / "learning")
    (world / "learning" / "flow.safetensors").unlink()
    infer = f"obpose-edit infer --checkpoint {world}/model --refine 0 --resolution 8x8"
    run(f"{infer} --data {world}/data --out {world}/scene")

    def interrupt(line: str) -> None:
        if line.startswith("step 1 of 1"):
            raise KeyboardInterrupt

    settings = FitSettings(18, steps=1, seed=0, workers=1, refinements=0, save_steps=1)
    with suppress(KeyboardInterrupt):
        fit_flow(load_origin(str(world / "learning")), world / "data", settings, interrupt)


LEARN = "obpose-edit fit-prior --kind flow --checkpoint {w}/learning --data {w}/data --clips 18 --steps 1 --workers 1"
CONTINUE = f"obpose-train --variant obpose --data {{w}}/data --steps 2 --out {{w}}/run {TINY}"
INFER_BY = "obpose-edit infer --checkpoint {w}/MODEL --data {w}/data --refine 0 --resolution 8x8 --out {o}"
SAMPLE = "obpose-edit sample --checkpoint {w}/model --camera {w}/scene --objects 1 --resolution 8x8 --out {o}"
SCORE_BY = "obpose-bench --checkpoint {w}/MODEL --name own --data {w}/data --workers 1 --out {o}"
VIEW_BY = "obpose-view {w}/MODEL --data {w}/data"
OF_SCENES = [
    "obpose-edit render {w}/scene --resolution 8x8 --out {o}.png",
    "obpose-edit mesh {w}/scene --object 1 --cells 8 --out {o}.ply",
    "obpose-edit move {w}/scene --object 1 --by 0.01,0,0 --resolution 8x8 --out {o}",
    "obpose-edit remove {w}/scene --object 1 --resolution 8x8 --out {o}",
    "obpose-edit rotate {w}/scene --object 1 --degrees 10 --resolution 8x8 --out {o}",
    "obpose-edit add {w}/scene --object 1 --by 0.02,0,0 --resolution 8x8 --out {o}",
    f"{SAMPLE} --prior gaussian",
    "obpose-view {w}/scene",
    "obpose-view {w}/scene --data {w}/data",
]


def _by(model: str, *commands: str) -> list[str]:
    return [command.replace("MODEL", model) for command in commands]


MODELS = Group(
    build_models,
    [
        Target("run/config.json", [CONTINUE, CONTINUE, *_by("run", INFER_BY, SCORE_BY, VIEW_BY)], 10),
        Target("run/model.safetensors", [*_by("run", INFER_BY, SCORE_BY, VIEW_BY)], 8),
        Target("run/training.safetensors", [CONTINUE], 10),
        Target("run/training.csv", [CONTINUE], 4),
        Target("run/validation.csv", [CONTINUE], 4),
        Target("obsurf/config.json", _by("obsurf", SCORE_BY), 4),
        Target("obsurf/model.safetensors", _by("obsurf", SCORE_BY), 3),
        Target("model/prior.safetensors", [f"{SAMPLE} --prior gaussian", f"{SAMPLE} --prior flow"], 8),
        Target("model/flow.safetensors", [f"{SAMPLE} --prior flow", SAMPLE], 6),
        Target("scene/scene.json", OF_SCENES, 14),
        Target("scene/scene.safetensors", OF_SCENES, 14),
        Target("learning/flow.partial/clip-00000.safetensors", [LEARN], 5),
        Target("learning/flow.partial/looking.json", [LEARN], 2),
        Target("learning/flow.partial/learning.json", [LEARN], 2),
        Target("learning/flow.partial/state.safetensors", [LEARN], 3),
    ],
)
