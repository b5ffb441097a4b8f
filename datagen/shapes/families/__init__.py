"""Shape families, one file each."""
