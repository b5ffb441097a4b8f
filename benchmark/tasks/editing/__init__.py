"""Edits of scenes that models infer, scored against edits that the generator rendered."""
