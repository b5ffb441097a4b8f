"""Mixtures of Gaussians, fitted to the latents that a model infers.

The priors that a model learns have little weight in training (`loss.kl`), and latents of real scenes fill only a few
of their directions. Mixtures fitted afterwards to the posterior means of training clips (ex-post density estimation,
Ghosh et al. 2020) match them better. A single Gaussian has most of its mass between the kinds of objects. No labels
are used. The learned priors (paper, section Object Location and Orientation Conditioned Encoding) are here too.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import torch
from safetensors.torch import save

from datagen.console.text import counted
from datagen.storage.atomic import write_atomically
from obpose.data.clips import select_part
from obpose.errors import CorruptFile, UsageError
from obpose.model.layers.latent import LATENT
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.light import is_light
from obpose.scenes.appearance.table_texture import PATCH
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import views_as_trained
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.interface import WEIGHTS, FitSettings, Say, ScenePrior, read_prior
from obpose.scenes.priors.mixture import Mixture, fit_mixture, normal
from obpose.scenes.priors.tables import MOST, Tables, find_tables, no_tables
from obpose.storage.tensors import Form, Forms, pack
from obpose.types import Observation

FILE = "prior.safetensors"
"""Name of the prior's file, in the folder of the model's weights."""
_AGAIN = "make it again with obpose-edit fit-prior --kind gaussian, or give --prior learned."
_PARTS = "weights", "means", "factors"
_MIXTURES = "what", "background"
_TABLES = {"lights", "spots"}
_MARGIN = 0.02
"""Share of the objects that are ignored at each end when the occupied part of the table is estimated."""


def fit_gaussian(origin: Origin, data: Path, settings: FitSettings, say: Say) -> Path:
    """Fit mixtures to the training clips of a dataset, with the tables of the first ones, and write the file.

    Raises:
        UsageError: too few objects were found for a covariance.
    """
    # Lights and textures need whole clips.
    tables = min(settings.clips, MOST)
    say(f"Looking for lights and textures in {counted(tables, 'clip')}; each takes some seconds.")

    def whole_clips() -> Iterator[Observation]:
        for place in range(tables):
            if place and place % 8 == 0:
                say(f"{place} of {counted(tables, 'clip')}")
            yield read_clip(data, "train", place)

    found = find_tables(origin, whole_clips(), refinements=settings.refinements)
    # Codes need first frames only.
    say(f"Looking at the first frames of {counted(settings.clips, 'clip')}.")
    clips = (select_part(read_clip(data, "train", i), frames=slice(1)) for i in range(settings.clips))
    return save_gaussian(
        origin, fit_codes(origin.model, (views_as_trained(origin.model, each) for each in clips), found)
    )


@torch.no_grad()
def fit_codes(model: ObPose, clips: Iterable[Observation], tables: Tables) -> ScenePrior:
    """Fit mixtures to posterior means of the first frames of clips, each a batch of one; `tables` stay as given.

    Raises:
        UsageError: too few objects were found for a covariance.
    """
    what, background, center = [], [], []
    for clip in clips:
        inference = model.segment(clip).inference
        assert inference.background is not None
        active = inference.masks.active[0]
        what.append(inference.what.mean[0, 0, active])
        center.append(inference.boxes.center[0, 0, active, :2])
        background.append(inference.background.mean[0, 0])
    objects, scenes = (torch.cat(what) if what else torch.zeros(0, 1)), len(background)
    if len(objects) < 2 or scenes < 2:
        raise UsageError(
            f"Objects found: {len(objects)} in {counted(scenes, 'clip')}; expected at least 2 in 2 clips. Give more "
            "--clips."
        )
    codes, backgrounds = CodePrior(fit_mixture(objects)), fit_mixture(torch.stack(background))
    # Objects are placed in the part of the table where nearly all of these are.
    low, high = (torch.quantile(torch.cat(center), share, dim=0) for share in (_MARGIN, 1 - _MARGIN))
    return ScenePrior(codes, backgrounds, tables, low, high)


def save_gaussian(origin: Origin, prior: ScenePrior) -> Path:
    """Write a prior for `load_gaussian` beside the weights it belongs to, packed; give the path of the file."""
    assert isinstance(prior.objects, CodePrior)
    tensors = {"low": prior.low, "high": prior.high, "lights": prior.tables.lights}
    for name, mixture in zip(_MIXTURES, (prior.objects.what, prior.background), strict=True):
        tensors |= {f"{name}.{part}": getattr(mixture, part) for part in _PARTS}
    contents = pack(tensors, "float16") | pack({"spots": prior.tables.patches}, "int8")
    write_atomically(origin.folder / FILE, save(contents, metadata={WEIGHTS: origin.hash}))
    return origin.folder / FILE


def load_gaussian(origin: Origin) -> ScenePrior:
    """Load the fitted mixtures of a model.

    Raises:
        UsageError: there are none.
        CorruptFile: the file is damaged, or belongs to another model.
    """
    path = origin.folder / FILE
    if not path.is_file():
        raise UsageError(f"{origin.folder} has no {FILE}; make one with obpose-edit fit-prior --kind gaussian first.")
    found = read_prior(origin, FILE, _AGAIN, _expected_file)
    what, background = (Mixture(*(found[f"{name}.{part}"] for part in _PARTS)) for name in _MIXTURES)
    # Priors of older versions have no tables.
    none = no_tables(found["low"])
    tables = Tables(found.get("lights", none.lights), found.get("spots", none.patches))
    wrong = what.fault() or background.fault()
    if not bool((found["low"] <= found["high"]).all()):
        wrong = "low is above high"
    if not all(map(is_light, tables.lights)):
        wrong = "lights are neither unit vectors nor none"
    if wrong:
        raise CorruptFile(f"{path} is damaged ({wrong}); {_AGAIN}")
    return ScenePrior(CodePrior(what), background, tables, found["low"], found["high"])


def _expected_file(found: Forms) -> Forms:
    """Give names, types and shapes: two mixtures, a part of the table, and optionally tables."""
    expected = {"low": Form(torch.float32, (2,)), "high": Form(torch.float32, (2,))}
    for name in _MIXTURES:
        parts = _length(found, f"{name}.weights")
        shapes = (parts,), (parts, LATENT), (parts, LATENT, LATENT)
        expected |= {f"{name}.{part}": Form(torch.float32, shape) for part, shape in zip(_PARTS, shapes, strict=True)}
    if _TABLES & found.keys():
        tables = _length(found, "lights")
        expected["lights"] = Form(torch.float32, (tables, 4))
        expected["spots"] = Form(torch.float32, (tables, PATCH, PATCH, 3))
    return expected


def _length(found: Forms, name: str) -> int:
    """Length of a tensor's first axis; 1 if there is none."""
    return found[name].shape[0] if name in found and found[name].shape else 1


def learned_prior(origin: Origin) -> ScenePrior:
    """Give the normal priors of z_what and z_bg in a first frame.

    They do not cover positions and tables: objects are put in the middle half of the workspace, tables have no light
    and no texture.
    """
    model = origin.model
    assert model.background is not None
    half, middle = model.config.model.workspace_size / 4, model.center[:2]
    what, background = normal(*model.what.first()), normal(*model.background.first())
    return ScenePrior(CodePrior(what), background, no_tables(middle), middle - half, middle + half)
