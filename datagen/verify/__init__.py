"""Proof that a dataset's pixels, poses and geometry agree, by exact distances and without the renderers' code."""

from datagen.verify.dataset import run
from datagen.verify.scene_case import Finding
from datagen.verify.scene_checks import verify_record

__all__ = ["Finding", "run", "verify_record"]
