"""A trained model on images whose pixels lie closer together or farther apart than those it was trained on."""

import copy

from obpose.config import override
from obpose.data.scene_stats import neighbour_distances
from obpose.model.obpose import ObPose
from obpose.types import Observation

TOLERANCE = 1.3
"""Spacings that differ by less are taken for the same: scenes of one kind differ as much."""


def surface_spacing(observation: Observation) -> float | None:
    """Median distance in metres between the surface points of neighbouring pixels; None where nothing was seen."""
    distances = neighbour_distances(observation)
    return float(distances.median()) if len(distances) else None


def spacing_note(model: ObPose, observation: Observation) -> str:
    """How far neighbouring pixels lie apart on the surfaces, in training too, and whether that is something else."""
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
    """The model with its neighbourhoods scaled to the images' spacing, where that is another; the weights are shared.

    A neighbourhood spans a fixed number of pixels. Its radius in metres follows from the distance between the surface
    points of neighbouring pixels, which depth, focal length and resolution decide.
    """
    trained, spacing = model.config.model.spacing, surface_spacing(observation)
    if spacing is None or 1 / TOLERANCE < spacing / trained < TOLERANCE:
        return model
    scaled = copy.copy(model)
    scaled.config = override(model.config, {"model.spacing": spacing})
    return scaled
