"""Adapt a trained model to images with another spacing of surface points than in training."""

import copy

from obpose.config import override
from obpose.data.scene_stats import neighbour_distances
from obpose.model.obpose import ObPose
from obpose.types import Observation

TOLERANCE = 1.3
"""Largest ratio of spacings that count as equal; scenes of one kind differ by as much."""


def surface_spacing(observation: Observation) -> float | None:
    """Median distance in metres between the surface points of neighbouring pixels; None without any depth."""
    distances = neighbour_distances(observation)
    return float(distances.median()) if len(distances) else None


def spacing_note(model: ObPose, observation: Observation) -> str:
    """Describe the spacing of surface points here and in training, and whether they differ."""
    trained, spacing = model.config.model.spacing, surface_spacing(observation)
    if spacing is None:
        return "no neighbouring pixels have a depth"
    words = (
        f"neighbouring pixels are {1000 * spacing:.1f} mm apart on the surfaces, in training {1000 * trained:.1f} mm"
    )
    if fitting_model(model, observation) is model:
        return words
    return f"{words}: the model was not trained for this and its neighbourhoods were scaled"


def fitting_model(model: ObPose, observation: Observation) -> ObPose:
    """Scale the model's neighbourhoods to the images' spacing, if it differs; the weights are shared.

    A neighbourhood spans a fixed number of pixels. Its radius in metres follows from the distance between the surface
    points of neighbouring pixels, which depends on depth, focal length and resolution.
    """
    trained, spacing = model.config.model.spacing, surface_spacing(observation)
    if spacing is None or 1 / TOLERANCE < spacing / trained < TOLERANCE:
        return model
    scaled = copy.copy(model)
    scaled.config = override(model.config, {"model.spacing": spacing})
    return scaled
