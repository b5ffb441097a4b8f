"""Convolutional network of the contact model: a U-Net with residual blocks (Ronneberger et al. 2015)."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

WIDTHS, BLOCKS = (24, 48, 96, 128), (1, 1, 2, 2)
"""Channels and residual blocks of each level, from fine to coarse."""
HEAD_WIDTH = 48


class Residual(nn.Module):
    """Two 3x3 convolutions whose result is added to the input (He et al. 2016, with normalisation first)."""

    def __init__(self, width: int):
        """Build the layers; the block starts as the identity."""
        super().__init__()
        self.layers = nn.Sequential(
            normalisation(width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False),
            normalisation(width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False),
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Conv2d)
        nn.init.zeros_(last.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Add the residual."""
        return x + self.layers(x)


class UNet(nn.Module):
    """Image-to-image network; sides are padded to multiples of eight."""

    def __init__(self, inputs: int, outputs: int):
        """Build the layers for given numbers of input and output channels."""
        super().__init__()
        self.stem = nn.Conv2d(inputs, WIDTHS[0], 3, padding=1)
        self.encoder = nn.ModuleList(
            nn.Sequential(*(Residual(width) for _ in range(count))) for width, count in zip(WIDTHS, BLOCKS, strict=True)
        )
        steps = list(pairwise(WIDTHS))
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in steps)
        self.lateral = nn.ModuleList(nn.Conv2d(coarse, fine, 1) for fine, coarse in steps)
        self.decoder = nn.ModuleList(Residual(fine) for fine, _ in steps)
        self.head = nn.Sequential(
            normalisation(WIDTHS[0]),
            nn.ReLU(),
            nn.Conv2d(WIDTHS[0], HEAD_WIDTH, 1),
            nn.ReLU(),
            nn.Conv2d(HEAD_WIDTH, outputs, 1),
        )

    def forward(self, images: Float[Tensor, "image input height width"]) -> Float[Tensor, "image output height width"]:
        """Compute the outputs at full resolution."""
        height, width = images.shape[-2:]
        multiple = 2 ** len(self.down)
        x = F.pad(images, (0, -width % multiple, 0, -height % multiple))
        x = self.stem(x.contiguous(memory_format=torch.channels_last))
        skipped = []
        for level, blocks in enumerate(self.encoder):
            x = blocks(x)
            if level < len(self.down):
                skipped.append(x)
                x = self.down[level](x)
        for lateral, block, skip in zip(reversed(self.lateral), reversed(self.decoder), reversed(skipped), strict=True):
            x = block(F.interpolate(lateral(x), scale_factor=2, mode="nearest") + skip)
        return self.head(x)[..., :height, :width]


def normalisation(width: int) -> nn.GroupNorm:
    """Group normalisation with groups of four or more channels (Wu and He 2018)."""
    return nn.GroupNorm(min(8, width // 4), width)
