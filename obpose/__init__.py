"""ObPose: object-centric 3D scene models, and the data they learn from."""


def __getattr__(name: str) -> str:
    """Give `__version__`, which takes longer to find than this package to import."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from datagen.version import find_version

    return find_version()
