"""The commands `obpose-train`, `obpose-segment`, `obpose-edit` and `obpose-view`."""
