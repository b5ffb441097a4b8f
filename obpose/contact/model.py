"""Contact model: tells touching objects apart, having learned from pasted contacts, and follows them over the clip.

A network gives every pixel of an image a foreground logit, an embedding, and affinities with its neighbours
(`obpose.contact.network`). It is trained on pseudo-objects that were pasted next to each other
(`obpose.contact.pasting`), without labels. At evaluation the pixels of each image are grouped by their affinities
(`obpose.contact.grouping`); over a clip, affinities of all images and the motion of parts decide
(`obpose.contact.clip`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from obpose.contact.clip import Image as ClipImage
from obpose.contact.clip import label_map, segment_clip
from obpose.contact.components import OFFSETS, image_components
from obpose.contact.config import ContactConfig
from obpose.contact.grouping import foreground_pairs
from obpose.contact.images import CHANNELS, Images, augmented, cropped, images_of
from obpose.contact.losses import affinity_loss, embedding_loss, foreground_loss
from obpose.contact.network import UNet
from obpose.contact.pasting import ClipsWithPasted, PastedClips, PseudoScene, least_pixels
from obpose.contact.self_training import DIVISION_BIAS, START, divided
from obpose.data.clean_depth import clean_depth, depth_noise
from obpose.data.clips import ClipSource, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.model.attention.given import Labels
from obpose.trainable import Trainable
from obpose.types import Observation, PastedObservation, Segmentation

EMBEDDING = 8
"""Channels of the embedding."""
POSITION, COLOUR = 8.0, 1.5
"""Factors of position in metres and of colour, which are added to channels of the embedding (Novotny et al. 2018)."""
CROP = 48
"""Edge of training crops in pixels, at 64 pixels' width."""
FOREGROUND, PUSH, AFFINITY = 2.0, 0.5, 2.0
"""Weights of the losses; that of the pull is 1."""


class Outputs(NamedTuple):
    """Outputs of the network for images."""

    foreground: Float[Tensor, "image height width"]
    """Logits."""
    embedding: Float[Tensor, "image channel height width"]
    affinities: Float[Tensor, "image offset height width"]
    """Logits of whether a pixel and its partner at each of `offsets` belong to the same object."""


class ContactModel(Trainable):
    """U-Net with heads for foreground, embedding and affinities."""

    observation_type = PastedObservation
    center: Tensor

    def __init__(self, config: ContactConfig):
        """Build the network with fresh weights from PyTorch's global generator."""
        super().__init__()
        self.config = config
        self.network = UNet(CHANNELS, self.channels)
        self.register_buffer("center", torch.tensor(config.model.workspace_center), persistent=False)
        self._teacher: Teacher | None = None

    @property
    def channels(self) -> int:
        """Number of output channels of the network."""
        return 1 + EMBEDDING + OFFSETS

    def training_source(self, source: ClipSource) -> ClipSource:
        """Paste training images from the clips of a source; labels of the source are not read."""
        return self.pasted_clips(source)

    def check_source(self, source: ClipSource) -> None:
        """Check that pasted clips show objects.

        Raises:
            UsageError: they do not.
        """
        if isinstance(source, PastedClips | ClipsWithPasted):
            source.check()

    def pasted_clips(self, source: ClipSource) -> PastedClips:
        """Images that are pasted from the clips of a source."""
        model = self.config.model
        settings = {"table": model.table, "floor": model.floor, "gap": model.gap, "clean": model.clean_depth}
        return PastedClips(source, **settings, seed=self.config.train.seed)

    def next_source(self, source: ClipSource, fraction: float) -> ClipSource:
        """Divide the pseudo-objects after `START` of the budget, if configured (`obpose.contact.self_training`)."""
        due = self.config.model.self_training and fraction >= START
        if not due or not isinstance(source, PastedClips | ClipsWithPasted) or source.divided:
            return source
        self._teacher = self._teacher or Teacher(self._copy())
        return source.divided_by(self._teacher)

    def training_state(self) -> dict[str, Tensor]:
        """Give the weights of the copy that divides the pseudo-objects, if there is one yet."""
        return self._teacher.model.state_dict() if self._teacher else {}

    def restore_training_state(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `training_state` gave.

        Raises:
            UsageError: it does not fit the model.
        """
        if not state:
            return
        model = self._copy()
        expected = model.state_dict()
        fits = state.keys() == expected.keys() and all(
            (state[name].shape, state[name].dtype) == (value.shape, value.dtype) for name, value in expected.items()
        )
        if not fits:
            raise UsageError(
                "The checkpoint's copy of the network that divides pseudo-objects does not fit the model of this "
                "version. Begin anew in another folder with --out."
            )
        model.load_state_dict(state)
        self._teacher = Teacher(model)

    def _copy(self) -> "ContactModel":
        """A copy on the CPU, in evaluation mode."""
        with torch.random.fork_rng(devices=[]):
            copy = type(self)(self.config)
        copy.load_state_dict(self.state_dict())
        return copy.eval()

    def images(self, observation: Observation) -> Images:
        """Clean the depth of an observation if so set, and arrange its images."""
        return images_of(self._cleaned(observation), center=self.center, table=self.config.model.table)

    def images_and_points(
        self, observation: Observation
    ) -> tuple[Images, Float[np.ndarray, "image height width 3"], Float[np.ndarray, "image height width 3"]]:
        """Give the images of `images`, and arrays of their world points, metres, and colours in 0..1."""
        observation = self._cleaned(observation)
        images = images_of(observation, center=self.center, table=self.config.model.table)
        points = rearrange(unproject(observation).cpu().numpy(), "b f v h w c -> (b f v) h w c")
        return images, points, rearrange(images.rgb.cpu().numpy(), "i c h w -> i h w c")

    def _cleaned(self, observation: Observation) -> Observation:
        # Pasted images are clean already.
        clean = self.config.model.clean_depth and not isinstance(observation, PastedObservation)
        return clean_depth(observation) if clean else observation

    def outputs(self, images: Images) -> Outputs:
        """Run the network."""
        found = self.network(images.inputs()).float()
        foreground, embedding, affinities = found.split([1, EMBEDDING, OFFSETS], dim=1)
        # Semi-convolutional embedding: equal objects at different places must differ.
        own = torch.cat([POSITION * images.points, COLOUR * (images.rgb - 0.5)], dim=1)
        rest = torch.zeros_like(embedding[:, : EMBEDDING - own.shape[1]])
        return Outputs(foreground[:, 0], embedding + torch.cat([own, rest], dim=1), affinities)

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the losses on augmented crops around the objects."""
        scale = self.config.model.image_scale
        images = cropped(augmented(self.images(observation), generator), CROP * scale, generator)
        foreground, embedding, affinities = self.outputs(images)
        pull, push = embedding_loss(embedding, images.labels)
        terms = {
            "foreground": foreground_loss(foreground, images.labels),
            "pull": pull,
            "push": push,
            "affinity": affinity_loss(affinities, images.labels, scale=scale),
        }
        total = FOREGROUND * terms["foreground"] + pull + PUSH * push + AFFINITY * terms["affinity"]
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """Label objects over whole clips, and over all views of a frame.

        `attention` holds the groups of single images, whose labels differ between images.
        """
        images = self.clip_images(observation)
        singles = [label_map(image.mask, image.groups(self.config.model.bias)) for image in images]
        single = torch.from_numpy(np.stack(singles)).view(observation.depth.shape).to(observation.depth.device)
        return Segmentation(labels=self._over_time(images, observation), attention=single * observation.valid)

    @torch.no_grad()
    def label_objects(self, observation: Observation) -> Labels:
        """Give the labels of `segment`, without the groups of single images."""
        return self._over_time(self.clip_images(observation), observation)

    def _over_time(self, images: list[ClipImage], observation: Observation) -> Labels:
        frames, views = observation.depth.shape[1:3]
        bias, gap = self.config.model.bias, self.config.model.gap
        clips = [images[first : first + frames * views] for first in range(0, len(images), frames * views)]
        noises = depth_noise(observation).tolist() if self.config.model.clean_depth else [0.0] * len(clips)
        found = [
            segment_clip(clip, bias=bias, gap=gap, views=views, noise=noise)
            for clip, noise in zip(clips, noises, strict=True)
        ]
        labels = torch.from_numpy(np.concatenate(found)).view(observation.depth.shape).to(observation.depth.device)
        return labels * observation.valid

    @torch.no_grad()
    def clip_images(self, observation: Observation) -> list[ClipImage]:
        """Clean the depth, run the network, and prepare its outputs for inference: batch, then frame, then view."""
        images, points, colours = self.images_and_points(observation)
        outputs = self.outputs(images)
        masks = self._foreground(outputs.foreground, images).cpu().numpy()
        embeddings = rearrange(outputs.embedding.cpu().numpy(), "i c h w -> i h w c")
        scale = self.config.model.image_scale
        pairs = [
            foreground_pairs(mask, affinities, scale=scale, components=parts)
            for mask, affinities, parts in zip(
                masks, outputs.affinities.cpu().numpy(), self._parts(points, masks), strict=True
            )
        ]
        return [
            ClipImage(mask, place, colour, pair, embedding[mask])
            for mask, place, colour, pair, embedding in zip(masks, points, colours, pairs, embeddings, strict=True)
        ]

    def _foreground(
        self, logits: Float[Tensor, "image height width"], images: Images
    ) -> Bool[Tensor, "image height width"]:
        """Foreground of the network; for exact depth, with the pixels next to it that lie above the floor.

        The network cannot tell these from the table: most are less than a millimetre above it.
        """
        found = (logits > 0) & images.valid
        if not self.config.model.exact:
            return found
        near = F.max_pool2d(found[:, None].float(), 3, stride=1, padding=1)[:, 0] > 0
        return found | (near & images.valid & (images.points[:, 2] > self.config.model.floor))

    def _parts(
        self, points: Float[np.ndarray, "image height width 3"], masks: Bool[np.ndarray, "image height width"]
    ) -> list[np.ndarray] | list[None]:
        """Connected components of the foreground of each image, which share no object, if so configured."""
        if (gap := self.config.model.division_gap) is None:
            return [None] * len(masks)
        return [image_components(*each, gap=gap, least=1) for each in zip(points, masks, strict=True)]


@dataclass(frozen=True, eq=False)
class Teacher:
    """Frozen copy of the model, made halfway through the training, which divides pseudo-objects."""

    model: ContactModel

    def __call__(self, scene: PseudoScene) -> UInt8[np.ndarray, "height width"]:
        """Divide the pseudo-objects of a scene that the model divides with certainty."""
        image = self.model.clip_images(observation_of([scene.window()], PastedObservation))[0]
        found = label_map(image.mask, image.groups(DIVISION_BIAS))
        return divided(scene.labels, found, least=least_pixels(scene.labels.size))
