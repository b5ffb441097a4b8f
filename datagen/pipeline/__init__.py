"""From a recipe to a dataset: simulate, render and store scenes in parallel."""
