"""Loss terms, one function each, unweighted, and their sum."""
