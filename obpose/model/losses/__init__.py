"""Loss terms, one unweighted function each, and their weighted sum."""
