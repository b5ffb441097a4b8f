"""Training examples of a flow: objects that a model finds in clips, cached in one file per clip."""

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors.torch import save
from torch import Tensor

from datagen.console.text import counted
from datagen.pipeline.parallel import make_all
from datagen.storage.atomic import write_atomically
from obpose.errors import CorruptFile
from obpose.model.layers.latent import LATENT
from obpose.model.nerf.detail import EDGE
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors.grids import Grids, grids_of, together
from obpose.scenes.priors.interface import FitSettings, Say
from obpose.scenes.scene import Scene
from obpose.storage.tensors import Form, Forms, read_tensors

FRAMES = 6
"""Largest number of frames used of a clip; moving objects show several sides."""
_MOST_BYTES = 2**28
_load_once = cache(load_origin)


@dataclass(frozen=True, eq=False)
class Examples:
    """Objects found in one clip."""

    grids: Grids
    """Density and colour grids of the objects, in up to `FRAMES` frames."""
    what: Float[Tensor, "object what"]
    """z_what of the objects in the last frame."""


def find_examples(origin: Origin, data: Path, folder: Path, settings: FitSettings, say: Say) -> list[Examples]:
    """Find objects in the first training clips of a dataset; clips that have a file in `folder` are read from it.

    Raises:
        CorruptFile: a file is damaged.
        UsageError: the dataset has fewer clips.
    """
    paths = [folder / f"clip-{index:05d}.safetensors" for index in range(settings.clips)]
    missing = [index for index, path in enumerate(paths) if not path.exists()]
    say(f"Looking for objects in {counted(len(missing), 'clip')} of {data}.")
    look = partial(_find_in, str(origin.folder), data, settings.refinements)
    for number, (index, contents) in enumerate(
        make_all(look, [("train", i) for i in missing], settings.workers), start=1
    ):
        write_atomically(paths[index], contents)
        if number % 10 == 0:
            say(f"{number} of {counted(len(missing), 'clip')}")
    return [_read(path) for path in paths]


def joined(examples: list[Examples]) -> Grids:
    """Concatenate the grids of all clips."""
    return together([each.grids for each in examples], like=torch.zeros(0))


def examples_of(model: ObPose, scene: Scene) -> bytes:
    """Serialise the objects of an inferred scene as the contents of a cache file."""
    frames = torch.linspace(0, scene.frames - 1, min(FRAMES, scene.frames)).round().int().tolist()
    grids = together([grids_of(model, scene, frame) for frame in frames], like=scene.what)
    tensors = {"values": grids.values.half(), "half": grids.half, "what": scene.what[-1]}
    return save({name: value.contiguous() for name, value in tensors.items()})


def _find_in(checkpoint: str, data: Path, refinements: int, split: str, index: int) -> tuple[int, bytes]:
    """Infer a clip; give its index and the contents of its cache file."""
    origin = _load_once(checkpoint)
    scene = infer_scene(origin, read_clip(data, split, index), refinements=refinements)
    return index, examples_of(origin.model, scene)


def _read(path: Path) -> Examples:
    advice = "delete it, and run the same command again."
    tensors, _ = read_tensors(path, advice, _expected_file, most_bytes=_MOST_BYTES)
    if not bool((tensors["half"] > 0).all()):
        raise CorruptFile(f"{path} is damaged (half has values below 0); {advice}")
    return Examples(Grids(tensors["values"], tensors["half"]), tensors["what"])


def _expected_file(found: Forms) -> Forms:
    """Give names, types and shapes of the tensors of a cache file; grids and codes may differ in number."""
    objects, codes = (found[name].shape[:1] if name in found else () for name in ("half", "what"))
    expected = {
        "values": Form(torch.float32, (*objects, EDGE, EDGE, EDGE, 4)),
        "half": Form(torch.float32, objects),
        "what": Form(torch.float32, (*codes, LATENT)),
    }
    return expected
