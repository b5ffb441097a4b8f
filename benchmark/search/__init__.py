"""A search of settings that was declared before it was run, and that no label decides: `obpose-bench search`."""
