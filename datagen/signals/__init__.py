"""Optional signals beside the images: optical flow, point tracks, normals, object coordinates and amodal masks.

All are computed from the stored poses and the rendered meshes, for the pixels as the renderer labelled them. They need
no random numbers except for the choice of tracked points, and leave all other arrays as they are.
"""

from collections.abc import Collection, Mapping

import numpy as np

from datagen.edits.edit_context import Stage
from datagen.schema import SceneRecord, Signal
from datagen.signals.amodal import amodal_fields
from datagen.signals.clip_surfaces import ClipSurfaces
from datagen.signals.flow import flow_fields
from datagen.signals.surface_maps import coordinate_fields, normal_fields
from datagen.signals.tracks import track_fields


def signals_record(
    stage: Stage, pixels: Mapping[str, np.ndarray], signals: Collection[Signal], rng: np.random.Generator
) -> SceneRecord:
    """All fields of some signals of a scene, given its images; `rng` chooses the points to track."""
    if not signals:
        return {}
    clip = ClipSurfaces(stage, pixels["segmentation"], pixels["depth"])
    record: SceneRecord = {}
    if "flow" in signals:
        record |= flow_fields(clip)
    if "normals" in signals:
        record |= normal_fields(clip)
    if "coordinates" in signals:
        record |= coordinate_fields(clip)
    if "amodal" in signals:
        record |= amodal_fields(clip, pixels["visibility/amodal_pixels"].shape[2])
    if "tracks" in signals:
        record |= track_fields(clip, rng)
    return record
