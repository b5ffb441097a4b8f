"""Choosing a renderer by name."""

import subprocess
import sys

import pytest

from datagen.errors import UsageError
from datagen.render import RENDERERS, make_renderer


def test_the_default_comes_first():
    assert RENDERERS == ("raster", "rich", "pyrender", "mitsuba")
    assert make_renderer("raster").name == "raster"


def test_an_unknown_name_suggests_the_nearest_one():
    with pytest.raises(
        UsageError, match=r"'rasta'; did you mean 'raster'\? There are: raster, rich, pyrender, mitsuba\."
    ):
        make_renderer("rasta")


def test_a_name_like_none_of_them_suggests_nothing():
    with pytest.raises(UsageError, match=r"^Unknown renderer 'xyz'; there are: raster, rich, pyrender, mitsuba\.$"):
        make_renderer("xyz")


def test_importing_the_package_imports_no_engine():
    code = (
        "import sys, datagen.render; print([m for m in ('numba', 'OpenGL', 'pyrender', 'trimesh') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_without_opengl_the_message_names_packages_and_the_way_out():
    code = (
        "import sys; sys.modules['OpenGL'] = None\n"
        "from datagen.render import make_renderer\n"
        "from datagen.errors import UsageError\n"
        "try: make_renderer('pyrender')\n"
        "except UsageError as error: print(error)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "libegl1 libgl1 libgl1-mesa-dri" in found.stdout
    assert "`--renderer raster`" in found.stdout
