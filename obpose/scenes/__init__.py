"""Scenes as values: inferred or sampled, edited, stored and rendered (paper, section Scene Generation and Editing)."""
