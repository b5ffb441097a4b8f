"""Who may import whom (docs/architecture.md), checked over the real files, and the checks over small bad ones."""

import ast
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.paths import ROOT

PACKAGES = ("assets", "datagen", "obpose", "benchmark")

ONLY_IN = {
    "pybullet": ("datagen/physics/bullet.py",),
    "pybullet_data": ("datagen/physics/bullet.py",),
    "pyrender": ("datagen/render/pyrender_gl.py",),
    "mitsuba": ("datagen/render/mitsuba_pt.py",),
    "drjit": ("datagen/render/mitsuba_pt.py",),
    "OpenGL": ("datagen/render/pyrender_gl.py",),
    "numba": ("datagen/render/kernels.py",),
    "torch": ("obpose/", "benchmark/models/adapters/", "benchmark/studies/"),
    "distributed": ("datagen/pipeline/cluster.py",),
    "huggingface_hub": ("datagen/formats/push.py",),
    "trimesh": ("datagen/meshes/read.py", "obpose/scenes/meshes.py", "obpose/rgbd/results.py"),
    "OpenEXR": ("datagen/storage/safe_io.py",),
    "hdf5plugin": ("datagen/storage/safe_io.py",),
    "embreex": ("datagen/meshes/raycast.py",),
    "coacd": ("datagen/meshes/coacd_process.py",),
    "viser": (
        "obpose/viewer/page.py",
        "obpose/viewer/panel.py",
        "obpose/viewer/server.py",
        "obpose/viewer/scene3d.py",
    ),
}
"""Third-party modules that only some files, or files of some folders, import."""

BELOW = {"assets": (), "datagen": ("assets",), "obpose": ("assets", "datagen"), "benchmark": PACKAGES}
"""Other packages that a package may import."""

LAYERS = (
    {"errors", "version", "console"},
    {
        "geometry",
        "scene",
        "schema",
        "config",
        "random_streams",
        "recipe_rules",
        "sensor_presets",
        "shapes",
        "catalog",
        "storage",
        "meshes",
        "rgbd",
    },
    {"sampling", "physics", "render", "sensor"},
    {"edits", "pipeline", "signals", "verify", "inspect", "formats"},
    {"tracks", "commands"},
)
"""Parts of `datagen` from the bottom up; none imports from a layer above its own."""

MAY_OPEN = (
    "datagen/storage/safe_io.py",
    "benchmark/execution/executor.py",  # lines from its own child process
    "benchmark/commands/selftest.py",  # a file of this package
)
"""Files that call HDF5, NPY, image and JSON readers themselves; all others use `datagen.storage.safe_io`."""


def test_every_import_follows_the_arrows():
    assert {path: found for path in sources() if (found := violations(path, (ROOT / path).read_text()))} == {}


def test_no_cycle_of_imports():
    graph = {module_name(path): set(imported_modules(path, (ROOT / path).read_text())) for path in sources()}
    assert cycle(graph) is None


def test_no_cycle_of_subpackages():
    files = {path: (ROOT / path).read_text() for path in sources()}
    assert cycle(subpackages(files)) is None


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("datagen/scene.py", "import obpose.data.datasets"),
        ("datagen/scene.py", "from benchmark.models import registry"),
        ("datagen/scene.py", "def late():\n    import pybullet"),
        ("datagen/scene.py", "from datagen import tracks"),
        ("datagen/scene.py", "from .pipeline import generate"),
        ("datagen/render/raster.py", "from numba import njit"),
        ("datagen/render/raster.py", "import pyrender.constants"),
        ("datagen/pipeline/generate.py", "from datagen.commands.cli import main"),
        ("datagen/render/raster.py", "from ..pipeline.generate import generate_dataset"),
        ("datagen/novelty.py", "import numpy"),
        ("datagen/verify/sphere_tracing.py", "from datagen.render.kernels import rasterize"),
        ("datagen/tracks.py", "import benchmark.metrics"),
        ("obpose/viewer/session.py", "import viser"),
        ("obpose/training/loop.py", "from benchmark.metrics import score"),
        ("benchmark/execution/jobs.py", "import torch.nn as nn"),
        ("benchmark/metrics/score.py", "from obpose.data import datasets"),
        ("assets/__init__.py", "import datagen"),
    ],
)
def test_a_bad_import_is_found(path: str, source: str):
    assert violations(path, source)


def test_only_safe_io_opens_files_from_outside():
    found = {path: calls for path in sources() if (calls := unsafe_calls((ROOT / path).read_text()))}
    assert {path: calls for path, calls in found.items() if path not in MAY_OPEN} == {}


@pytest.mark.parametrize(
    ("source", "unsafe"),
    [
        ("h5py.File(path)", True),
        ("h5py.File(path, 'r')", True),
        ("h5py.File(path, mode='r+')", True),
        ("h5py.File(path, 'w')", False),
        ("np.load(path)", True),
        ("numpy.load(path)", True),
        ("Image.open(path)", True),
        ("json.load(file)", True),
        ("json.loads(text)", True),
        ("json.loads(json.dumps(value))", False),
        ("parse_json(text)", False),
    ],
)
def test_an_unsafe_call_is_found(source: str, unsafe: bool):
    assert bool(unsafe_calls(source)) == unsafe


def test_a_cycle_of_subpackages_is_found():
    files = {
        "datagen/render/raster.py": "from datagen.pipeline.records import pixel_record",
        "datagen/pipeline/generate.py": "import datagen.render.kernels",
        "datagen/pipeline/records.py": "from datagen.scene import Scene",
    }
    assert cycle(subpackages(files)) == ["datagen.render", "datagen.pipeline", "datagen.render"]


def test_a_cycle_is_found():
    assert cycle({"a": {"b"}, "b": {"c", "d"}, "c": {"a"}, "d": set()}) == ["a", "b", "c", "a"]


@pytest.mark.parametrize("module", ["datagen.schema", "datagen.storage.reader"])
def test_reading_costs_numpy_h5py_and_deflate_only(module: str):
    assert third_party_modules_of(module) <= {"numpy", "h5py", "deflate"}


def third_party_modules_of(module: str) -> set[str]:
    """Installed packages that a fresh interpreter loads for `module`, our own left out."""
    code = (
        "import sys; before = set(sys.modules)\n"
        f"import {module}\n"
        "new = [name for name in set(sys.modules) - before if getattr(sys.modules[name], '__file__', None)]\n"
        "print(' '.join({name.partition('.')[0] for name in new} - sys.stdlib_module_names))"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(result.stdout.split()) - set(PACKAGES)


def sources() -> list[str]:
    """All source files, as paths from the root."""
    return sorted(str(path.relative_to(ROOT)) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def unsafe_calls(source: str) -> list[str]:
    """Calls that open or parse a file without the checks of `datagen.storage.safe_io`."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    return [ast.unparse(call) for call in calls if is_unsafe(call)]


def is_unsafe(call: ast.Call) -> bool:
    """Whether a call reads what may come from outside; writing HDF5 and copying values through JSON are safe."""
    name = ast.unparse(call.func)
    if name == "h5py.File":
        mode = next((word.value for word in call.keywords if word.arg == "mode"), None) or (call.args[1:2] or [None])[0]
        return mode is None or ast.unparse(mode) != "'w'"
    if name == "json.loads":
        return not ast.unparse(call.args[0]).startswith("json.dumps(")
    return name in ("json.load", "np.load", "numpy.load", "Image.open")


def violations(path: str, source: str) -> list[str]:
    """One line for each import in `source`, the file at `path`, that the rules forbid."""
    imports = imported_modules(path, source)
    found = [f"{path} imports {name}: {reason}" for name in imports for reason in reasons_against(path, name)]
    if path.startswith("datagen/") and layer(module_name(path)) is None:
        found.append(f"{path} has no place in LAYERS")
    return found


def reasons_against(path: str, imported: str) -> Iterator[str]:
    """Why the file at `path` must not import the module `imported`."""
    package, target = path.partition("/")[0], imported.partition(".")[0]
    if target in ONLY_IN and not path.startswith(ONLY_IN[target]):
        yield f"only {' and '.join(ONLY_IN[target])} may"
    if target in PACKAGES and target not in (package, *BELOW[package]):
        yield f"{target} is above {package}"
    if package == target == "datagen" and above(imported, module_name(path)):
        yield "it is in a layer above"
    if path.startswith("datagen/verify/") and imported.startswith("datagen.render"):
        yield "a check must not share code with what it checks"
    if path.startswith("benchmark/metrics/") and target == "obpose":
        yield "metrics need NumPy only"


def above(imported: str, importer: str) -> bool:
    """Whether the first of two modules of `datagen` stands in a layer above the second's."""
    high, low = layer(imported), layer(importer)
    return high is not None and low is not None and high > low


def layer(module: str) -> int | None:
    """Layer of a module of `datagen`, which the package itself does not have; None if it is in none."""
    part = module.split(".")[1] if "." in module else ""
    return 0 if not part else next((level for level, parts in enumerate(LAYERS) if part in parts), None)


def module_name(path: str) -> str:
    """`a/b.py` is a.b, `a/__init__.py` is a."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def imported_modules(path: str, source: str) -> list[str]:
    """Absolute names of the modules that a file imports, anywhere in it; `from a import b` may mean a.b."""
    package = module_name(path) if path.endswith("__init__.py") else module_name(path).rpartition(".")[0]
    found: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parts, *([node.module] if node.module else [])])
            found += [submodule if is_module(submodule := f"{base}.{alias.name}") else base for alias in node.names]
    return found


def subpackages(files: dict[str, str]) -> dict[str, set[str]]:
    """Folders and those beside them that they import from, given the source of each file by path."""
    graph: dict[str, set[str]] = {}
    for path, source in files.items():
        for imported in imported_modules(path, source):
            pairs = zip(parents(module_name(path)), parents(imported), strict=False)
            one, two = next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))
            if "." in one and is_folder(one) and is_folder(two):
                graph.setdefault(one, set()).add(two)
    return graph


def parents(module: str) -> list[str]:
    """A module's packages and itself: `a.b` gives a and a.b."""
    parts = module.split(".")
    return [".".join(parts[: length + 1]) for length in range(len(parts))]


def is_folder(name: str) -> bool:
    """Whether a dotted name is a package of ours."""
    return (ROOT / name.replace(".", "/") / "__init__.py").is_file()


def is_module(name: str) -> bool:
    """Whether a dotted name is a module or package of ours."""
    path = ROOT / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or is_folder(name)


def cycle(graph: dict[str, set[str]]) -> list[str] | None:
    """Modules that import one another in a ring, the first one repeated at the end; None if there is no ring."""
    done: set[str] = set()

    def search(trail: list[str]) -> list[str] | None:
        for name in sorted(graph.get(trail[-1], ())):
            if name in trail:
                return [*trail[trail.index(name) :], name]
            if name not in done and (ring := search([*trail, name])):
                return ring
        done.add(trail[-1])
        return None

    return next((ring for name in graph if name not in done and (ring := search([name]))), None)
