"""Counterfactual edits of a scene, rendered like the scene itself: what a model's own edits can be held against."""

from datagen.edits.record import edits_record

__all__ = ["edits_record"]
