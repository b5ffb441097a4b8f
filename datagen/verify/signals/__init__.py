"""Checks of optional signals against stored depth, stored poses and exact solids, without the code that made them."""

from datagen.verify.signals.amodal import check_amodal
from datagen.verify.signals.coordinates import check_coordinates
from datagen.verify.signals.flow import check_flow
from datagen.verify.signals.normals import check_normals
from datagen.verify.signals.tracks import check_tracks

__all__ = ["check_amodal", "check_coordinates", "check_flow", "check_normals", "check_tracks"]
