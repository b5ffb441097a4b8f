"""The parts of ObSuRF beside those of the published code (MIT licence), of which this repository has no copy.

git clone https://github.com/stelzner/obsurf published && git -C published checkout ff16d23
OBSURF=published python -m pytest tests/obpose/baselines/obsurf/test_published.py

Weights are copied from ours to theirs, numbers have double precision. Of the encoder all is compared but what ours has
in the place of norms over batches, and of the camera's position.
"""

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from obpose.baselines.obsurf import losses
from obpose.baselines.obsurf.config import DecoderConfig, ImageEncoderConfig
from obpose.baselines.obsurf.decoder import SlotField
from obpose.baselines.obsurf.encoder import FIRST_OCTAVE, ImageEncoder, code_size, fourier_code
from obpose.baselines.obsurf.slots import SlotAttention

pytestmark = pytest.mark.skipif("OBSURF" not in os.environ, reason="OBSURF names no checkout of the published code")

IMAGES, POINTS, SLOTS, WIDTH, HIDDEN = 3, 100, 5, 48, 64
OCTAVES = {"last": 3}
SIGMA_MAX, STD = 10.0, 0.2


@pytest.fixture(scope="module")
def published() -> Iterator[Any]:
    """Imports its modules without what they import and do not need here."""
    folder = Path(os.environ["OBSURF"]).resolve() / "obsurf"
    names = ("obsurf", "obsurf.model", "obsurf.utils", "obsurf.common", "obsurf.config", "torchvision")
    made = {name: ModuleType(name) for name in names}
    made["torchvision"].models = Torchvision  # pyright: ignore[reportAttributeAccessIssue]
    made["obsurf"].__path__, made["obsurf.model"].__path__ = [str(folder)], [str(folder / "model")]
    made["obsurf.utils"].__path__ = [str(folder / "utils")]
    made["obsurf"].config = made["obsurf.config"]  # pyright: ignore[reportAttributeAccessIssue]
    made["obsurf.common"].make_2d_grid = None  # pyright: ignore[reportAttributeAccessIssue]
    model = {"max_density": SIGMA_MAX, "obj_kernel": None}
    made["obsurf.config"].CFG = {  # pyright: ignore[reportAttributeAccessIssue]
        "model": model,
        "training": {"color_std": STD},
    }
    before = sys.modules.copy()
    sys.modules |= made
    yield importlib.import_module
    for name in [name for name in sys.modules if name.split(".")[0] in ("obsurf", "torchvision")]:
        del sys.modules[name]
    sys.modules |= {name: module for name, module in before.items() if name.split(".")[0] == "torchvision"}


@pytest.fixture
def double() -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    torch.manual_seed(0)
    yield
    torch.set_default_dtype(before)


@pytest.mark.usefixtures("double")
def test_encoder(published: Any):
    octaves = {"last": 10}
    config = ImageEncoderConfig(width=WIDTH, blocks=(2, 6), cell=4)
    ours = ImageEncoder(config, camera_code=code_size(**octaves))
    size = {"c_dim": WIDTH, "h_dim": WIDTH, "att_height": 6, "att_width": 8}
    theirs = published("obsurf.encoder").ConvSlotEncoder(**size, downsample=2, use_camera_pos=True, resnet="resnet18")
    copy_encoder(ours, theirs)
    rgb, rays, camera = torch.rand(IMAGES, 24, 32, 3), torch.randn(IMAGES, 24, 32, 3), torch.randn(IMAGES, 3)
    found, _ = theirs(rgb.permute(0, 3, 1, 2), camera, rays)
    same(ours(rgb, rays, torch.zeros(IMAGES, 24, 32, 4), fourier_code(camera, **octaves)), found)


@pytest.mark.usefixtures("double")
def test_slots(published: Any, monkeypatch: pytest.MonkeyPatch):
    ours = SlotAttention(slots=SLOTS, width=WIDTH)
    size = {"height": 0, "width": 0, "dim": WIDTH, "hidden_dim": WIDTH}
    theirs = published("obsurf.layers").SlotAttention(SLOTS, **size, iters=5, self_attention=True)
    theirs.mlp[0], theirs.mlp[2] = ours.mlp[0], ours.mlp[2]
    theirs.slots_mu.data, theirs.slots_sigma.data = ours.mean.data, ours.spread.data
    theirs.to_q, theirs.to_k, theirs.to_v = ours.query, ours.key, ours.value
    theirs.norm_input, theirs.norm_slots, theirs.norm_pre_ff = ours.token_norm, ours.slot_norm, ours.mlp_norm
    theirs.gru = ours.update
    theirs.self_att.load_state_dict(ours.between.state_dict())
    tokens, noise = torch.randn(IMAGES, 64, WIDTH), torch.randn(IMAGES, SLOTS, WIDTH)
    monkeypatch.setattr(torch, "normal", lambda mean, std: mean + std * noise)
    same(ours(tokens, noise).codes, theirs(tokens))


@pytest.mark.usefixtures("double")
def test_fields_and_losses(published: Any):
    ours = SlotField(DecoderConfig(width=HIDDEN), code=code_size(**OCTAVES), slot=WIDTH, pixel=WIDTH)
    sizes = {"c_dim": WIDTH, "hidden_size": HIDDEN, "num_layers": 5, "num_color_features": WIDTH}
    code = {"start_freq": FIRST_OCTAVE, "num_freqs": OCTAVES["last"] + 1 - FIRST_OCTAVE}
    theirs = published("obsurf.model.decoder_modules").NerfDecoder(
        **sizes, **code, view_dependent_values=True, net_arch="ain"
    )
    copy_field(ours, theirs)
    points, target = torch.randn(IMAGES, POINTS, 3), torch.rand(IMAGES, POINTS, 3)
    directions = torch.nn.functional.normalize(torch.randn(IMAGES, POINTS, 3), dim=-1)
    seen, slots = torch.randn(IMAGES, POINTS, WIDTH), torch.randn(IMAGES, SLOTS, WIDTH)
    logits, hidden = ours.density(fourier_code(points, **OCTAVES), slots)
    colours = ours.colour(hidden, directions, seen)

    def each(values: Tensor) -> Tensor:
        return values.repeat_interleave(SLOTS, dim=0)

    found = theirs(
        each(points), slots.flatten(0, 1)[:, None], color_features=each(seen), rays=each(directions)
    ).unflatten(0, (IMAGES, SLOTS))
    same(logits, found[..., 0])
    same(colours, found[..., 1:].sigmoid())

    scene = published("obsurf.model.representations").Nerf3dSceneRepresentation(found, None)
    weight, density = torch.ones(IMAGES, 1, POINTS), scene.global_presence()
    logits, colours, target = logits[:, None], colours[:, None], target[:, None]
    composed = losses.mean_colour(logits, colours)
    same(losses.colour(composed, target, weight, std=STD), -scene.likelihood(target[:, 0]).sum(-1).mean())
    same(losses.surface(logits, weight), -density.log().mean())
    length = torch.rand(IMAGES, POINTS)
    same(losses.air(logits, length[:, None], weight), (length * density).mean())
    overlap = density - scene.local_presence().amax(dim=1)
    same(losses.overlap(logits, weight), overlap.mean())


class Block(nn.Module):
    """The residual block of torchvision, on which their encoder is built."""

    def __init__(self, inputs: int, width: int, stride: int, downsample: nn.Module | None, norm: Any):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 3, stride=stride, padding=1, bias=False)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn1, self.bn2, self.downsample = norm(width), norm(width), downsample

    def forward(self, features: Tensor) -> Tensor:
        branch = self.bn2(self.conv2(self.bn1(self.conv1(features)).relu()))
        return (branch + (features if self.downsample is None else self.downsample(features))).relu()


class Torchvision:
    """What their encoder takes of torchvision, which need not be installed."""

    class resnet:
        BasicBlock = Block

    class ResNet(nn.Module):
        def _make_layer(self, block: Any, width: int, count: int, stride: int = 1) -> nn.Sequential:
            norm, down = self._norm_layer, None
            if stride > 1:
                down = nn.Sequential(nn.Conv2d(self.inplanes, width, 1, stride=stride, bias=False), norm(width))
            return nn.Sequential(
                block(self.inplanes, width, stride, down, norm),
                *(block(width, width, 1, None, norm) for _ in range(count - 1)),
            )


def copy_encoder(ours: ImageEncoder, theirs: Any) -> None:
    """Norms of theirs become those of ours, and neither sees the camera."""
    nn.init.zeros_(ours.camera.weight)
    nn.init.zeros_(ours.camera.bias)
    unseen = torch.zeros(WIDTH, theirs.resnet.conv1.in_channels - 6, 7, 7)
    theirs.resnet.conv1.weight.data = torch.cat([ours.stem.weight, unseen], dim=1).data
    theirs.resnet.bn1 = ours.norm
    blocks = [block for layer in range(1, 5) for block in getattr(theirs.resnet, f"layer{layer}")]
    for one, other in zip(ours.blocks, blocks, strict=True):
        other.conv1, other.conv2 = one.first, one.second
        other.bn1, other.bn2 = one.norms
        assert (other.downsample is None) is isinstance(one.skip, nn.Identity)
        if other.downsample is not None:
            other.downsample = one.skip
    theirs.norm, theirs.fc1, _, theirs.fc2 = ours.head


def copy_field(ours: SlotField, theirs: Any) -> None:
    """Theirs has a linear layer between the hidden ones and the colours, which becomes the identity."""
    for place, hidden in enumerate(ours.hidden):
        shift, scale = ours.shifts[place], ours.scales[place]
        condition = theirs.net.cond_layers[place]
        condition.weight.data = torch.cat([shift.weight, scale.weight]).data  # pyright: ignore[reportArgumentType]
        condition.bias.data = torch.cat([shift.bias, scale.bias]).data  # pyright: ignore[reportArgumentType]
        theirs.net.main_layers[place] = hidden
    last = theirs.net.main_layers[-1]
    last.weight.data = torch.cat([ours.density_logit.weight, torch.eye(HIDDEN)]).data
    last.bias.data = torch.cat([ours.density_logit.bias, torch.zeros(HIDDEN)]).data
    direction, seen = ours.colour_seen.weight.split([3, WIDTH], dim=1)
    theirs.color_predictor[0].weight.data = torch.cat([ours.colour_hidden.weight, seen, direction], dim=1).data
    theirs.color_predictor[0].bias.data = ours.colour_hidden.bias.data
    theirs.color_predictor[2] = ours.colour_out


def same(one: Tensor, other: Tensor) -> None:
    torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-8)
