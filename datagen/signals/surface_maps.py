"""Maps of the surface behind each pixel: normals and object coordinates."""

import numpy as np

from datagen.schema import COORDINATE_SCALE, NORMAL_SCALE, SceneRecord
from datagen.signals.clip_surfaces import ClipSurfaces


def normal_fields(clip: ClipSurfaces) -> SceneRecord:
    """Fields of the group `normals`: those that the meshes are shaded with, in the camera's axes."""
    frames, views, height, width = clip.shape
    normals = np.zeros((*clip.shape, 3), np.int16)
    for frame in range(frames):
        for view in range(views):
            rotation = clip.stage.scene.cameras[view].at(frame).world_from_camera[:3, :3]
            local = clip.turn(clip.surface(frame, view), frame) @ rotation
            normals[frame, view] = np.rint(NORMAL_SCALE * local).reshape(height, width, 3)
    return {"normals": normals}


def coordinate_fields(clip: ClipSurfaces) -> SceneRecord:
    """Fields of the group `coordinates`: the place within the object's minimum-volume box, 0 to 1 along each axis."""
    frames, views, height, width = clip.shape
    coordinates = np.zeros((*clip.shape, 3), np.uint16)
    for frame in range(frames):
        for view in range(views):
            points, image = clip.surface(frame, view), np.zeros((height * width, 3))
            for row, shape in enumerate(clip.stage.shapes):
                own, box = points.row == row, shape.minimum_box
                image[own] = (points.local[own] - box.center) @ box.rotation / box.size + 0.5
            stored = np.rint(COORDINATE_SCALE * np.clip(image, 0, 1))
            coordinates[frame, view] = stored.reshape(height, width, 3)
    return {"object_coordinates": coordinates}
