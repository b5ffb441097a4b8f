"""Images, depth and ids of a scene: renderers behind one protocol.

Engines are imported when one is made, so that importing this package costs neither numba nor OpenGL.
"""

from datagen.errors import unknown_name
from datagen.render.renderer import Image, Renderer

__all__ = ["RENDERERS", "Image", "Renderer", "make_renderer"]


RENDERERS = ("raster", "rich", "pyrender", "mitsuba")
"""Names that `make_renderer` knows; the first one is the default."""


SAMPLES = 64
"""Default number of paths per pixel of `mitsuba`."""


def make_renderer(name: str, *, samples: int = SAMPLES) -> Renderer:
    """A renderer by name.

    Raises:
        UsageError: there is none of that name, or what it needs is not installed.
    """
    if name in ("raster", "rich"):
        from datagen.render.raster import RasterRenderer

        return RasterRenderer(rich=name == "rich")
    if name == "mitsuba":
        from datagen.render.mitsuba_pt import MitsubaRenderer

        return MitsubaRenderer(samples)
    if name == "pyrender":
        from datagen.render.pyrender_gl import PyrenderRenderer

        return PyrenderRenderer()
    raise unknown_name("renderer", name, RENDERERS)
