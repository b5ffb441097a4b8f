"""Fields of objects and background: evaluation, composition, shapes and pictures (paper, section Decoder)."""
