"""Labels of a whole clip as an array, whether its views are one scene or scenes of their own."""

import numpy as np
from einops import rearrange
from jaxtyping import Int

from obpose.config import Views
from obpose.data.clips import views_apart
from obpose.trainable import Trainable
from obpose.types import Observation

Labels = Int[np.ndarray, "frame view height width"]


def segment_clip(model: Trainable, clip: Observation, views: Views) -> Labels:
    """Labels of a batch of one clip, 0 = background; those of views that are not together say nothing of each other."""
    if views == "together":
        labels = rearrange(model.segment(clip).labels, "1 frame view h w -> frame view h w")
    else:
        labels = rearrange(model.segment(views_apart(clip)).labels, "view frame 1 h w -> frame view h w")
    return labels.cpu().numpy()
