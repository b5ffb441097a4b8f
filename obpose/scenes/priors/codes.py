"""Objects from codes: z_what of a mixture of normal distributions, without residual details."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.obpose import ObPose
from obpose.scenes.appearance import no_appearance
from obpose.scenes.bounds import LEAST_VOXELS, occupied
from obpose.scenes.priors.interface import Objects
from obpose.scenes.priors.mixture import Mixture

_TRIES = 200
"""Attempts to draw an object that has enough voxels."""
_Thing = TypeVar("_Thing")


@dataclass(frozen=True, eq=False)
class CodePrior:
    """Distribution of objects by their codes."""

    what: Mixture

    @torch.no_grad()
    def draw(self, model: ObPose, count: int, generator: torch.Generator) -> Objects:
        """Draw codes of objects that have enough voxels; after too many attempts, any codes.

        In models with sharp surfaces, some codes of a Gaussian give hardly any density. They are drawn again, as are
        objects only in the upper half of their box, whose box centre would be below the table.
        """

        def voxels(code: Float[Tensor, "latent"]) -> int:
            found = occupied(model, model.object_field.condition(code))
            return len(found) if len(found) and bool(found[:, 2].min() <= 0) else 0

        codes = draw_dense(lambda missing: list(self.what.draw(missing, generator)), voxels, count)
        what = torch.stack(codes) if codes else self.what.draw(0, generator)
        return Objects(what, no_appearance(count, what), face_camera=False)


def draw_dense(draw: Callable[[int], list[_Thing]], voxels: Callable[[_Thing], int], count: int) -> list[_Thing]:
    """Draw objects; draw those with too few voxels again, up to `_TRIES` times."""
    drawn = draw(count)
    for _ in range(_TRIES):
        empty = [place for place, each in enumerate(drawn) if voxels(each) < LEAST_VOXELS]
        if not empty:
            break
        for place, each in zip(empty, draw(len(empty)), strict=True):
            drawn[place] = each
    return drawn
