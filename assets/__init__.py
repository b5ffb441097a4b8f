"""Data that ships with the package: recipes and trained weights."""

from pathlib import Path

ROOT = Path(__file__).parent
RECIPES = ROOT / "recipes"
CHECKPOINTS = ROOT / "checkpoints"
