"""The paper's own claims, measured against what the generator knows (docs/results.md has the numbers)."""
