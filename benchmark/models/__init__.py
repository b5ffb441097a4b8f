"""Models of the benchmark: interface, registry, plug-ins, and all implementations."""
