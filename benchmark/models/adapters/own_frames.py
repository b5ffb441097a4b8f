"""Models of the benchmark on frames of a table, prepared as `obpose-segment` prepares them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmark.models.adapters.learned import LearnedSegmenter
from benchmark.models.interface import Clip, Prediction, Segmenter
from datagen.errors import NoTable, UsageError
from datagen.rgbd import OBJECTS
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import prepare, trained_on
from obpose.rgbd.recording import Recording
from obpose.rgbd.segment import UNTRAINED, Labels, segment_frames
from obpose.types import Observation


def segment_observation(segmenter: Segmenter, observation: Observation) -> Labels:
    """Label the objects of a batch of one clip with one view, from 1; 0 is the background."""
    names = ("rgb", "depth", "valid", "k", "world_from_camera")
    arrays = {name: getattr(observation, name)[0].numpy() for name in names}
    prediction = segmenter.segment(Clip(**{**arrays, "rgb": (255 * arrays["rgb"]).round().astype("uint8")}))
    return np.where(prediction.labels == prediction.background_slot, 0, prediction.labels + 1)[:, 0]


def table_segmenter(segmenter: Segmenter) -> Callable[[Clip], Prediction]:
    """Make a function that segments clips with a table, with as many objects at most as `obpose-segment` looks for."""
    wide = segmenter.looking_for(OBJECTS) if isinstance(segmenter, LearnedSegmenter) else segmenter
    return partial(segment_table, wide)


def segment_table(segmenter: Segmenter, clip: Clip) -> Prediction:
    """Segment what stands on the table of a clip; everything is background if no table is found.

    Raises:
        UsageError: the clip has several views, or the model cannot segment frames of a user.
    """
    if clip.depth.shape[1] > 1:
        raise UsageError("The frames have several views; expected those of one camera.")
    config = getattr(segmenter, "config", None)
    trained = UNTRAINED if config is None else trained_on(config)
    poses = np.repeat(clip.world_from_camera.astype(np.float64), len(clip.depth), axis=0)
    recording = Recording((Path(),) * len(poses), clip.rgb[:, 0], clip.depth[:, 0], clip.k[0], poses)
    try:
        frames = prepare(recording, Frames(), trained)
    except NoTable:
        return Prediction(np.zeros(clip.depth.shape, np.uint8), background_slot=0)
    method = partial(segment_observation, segmenter)
    labels = segment_frames(frames, method, video=len(poses) > 1, most=OBJECTS)
    return Prediction(labels[:, None], background_slot=0)
