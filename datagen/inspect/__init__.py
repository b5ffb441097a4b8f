"""Statistics, previews and cards of datasets."""
