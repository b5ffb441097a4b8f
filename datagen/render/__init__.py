"""Images, depth and ids of a scene: two renderers behind one protocol.

Engines are imported when one is made, so that importing this package costs neither numba nor OpenGL.
"""

from collections.abc import Callable

from datagen.errors import unknown_name
from datagen.render.renderer import Image, Renderer

__all__ = ["RENDERERS", "Image", "Renderer", "make_renderer"]


def _raster() -> Renderer:
    from datagen.render.raster import RasterRenderer

    return RasterRenderer()


def _pyrender() -> Renderer:
    from datagen.render.pyrender_gl import PyrenderRenderer

    return PyrenderRenderer()


_MAKERS: dict[str, Callable[[], Renderer]] = {"raster": _raster, "pyrender": _pyrender}

RENDERERS: tuple[str, ...] = tuple(_MAKERS)
"""Names that `make_renderer` knows; the first one is the default."""


def make_renderer(name: str) -> Renderer:
    """A renderer by name.

    Raises:
        UsageError: there is none of that name, or what it needs is not installed.
    """
    if name not in _MAKERS:
        raise unknown_name("renderer", name, RENDERERS)
    return _MAKERS[name]()
