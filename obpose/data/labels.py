"""Labels of a whole clip as an array, with its views joint or separate."""

import numpy as np
from einops import rearrange
from jaxtyping import Int

from obpose.config import Views
from obpose.data.clips import separate_views
from obpose.trainable import Trainable
from obpose.types import Observation

Labels = Int[np.ndarray, "frame view height width"]


def segment_clip(model: Trainable, clip: Observation, views: Views) -> Labels:
    """Segment a batch of one clip, 0 = background. Labels of separate views are unrelated."""
    if views == "all":
        labels = rearrange(model.segment(clip).labels, "1 frame view h w -> frame view h w")
    else:
        labels = rearrange(model.segment(separate_views(clip)).labels, "view frame 1 h w -> frame view h w")
    return labels.cpu().numpy()
