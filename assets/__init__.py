"""Data that ships with the package: recipes."""

from pathlib import Path

ROOT = Path(__file__).parent
RECIPES = ROOT / "recipes"
