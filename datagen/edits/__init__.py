"""Counterfactual edits of a scene, rendered like the scene itself; ground truth for the edits of a model."""

from datagen.edits.record import edits_record

__all__ = ["edits_record"]
