"""One version for all packages and commands, found without slow imports."""

import subprocess
import sys
import tomllib
from importlib import metadata

import pytest

import benchmark
import datagen
import obpose
from datagen.version import find_version
from tests.worlds.generated import ROOT

COMMANDS = {
    "obpose-datagen": "from datagen.commands.entry import main",
    "obpose-train": "from benchmark.commands.train import main",
    "obpose-segment": "from benchmark.commands.segment import main",
    "obpose-edit": "from obpose.commands.entry import edit as main",
    "obpose-view": "from obpose.commands.entry import view as main",
    "obpose-bench": "from benchmark.commands.entry import main",
}


def declared_version() -> str:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_all_packages_state_the_version_of_the_project():
    assert {package.__version__ for package in (datagen, obpose, benchmark)} == {declared_version()}


@pytest.mark.parametrize("package", [datagen, obpose, benchmark])
def test_other_names_are_still_unknown(package: object):
    assert not hasattr(package, "__versions__")


def test_a_checkout_that_is_not_installed_has_a_version(monkeypatch: pytest.MonkeyPatch):
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    assert find_version() == declared_version()


@pytest.mark.parametrize("program", COMMANDS)
def test_every_command_answers_without_slow_imports(program: str):
    code = (
        f"import sys; sys.argv = ['x', '--version']; {COMMANDS[program]}\n"
        "code = main()\n"
        "print(sorted({'torch', 'numpy', 'h5py', 'numba'} & set(sys.modules)), code or 0, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout == f"{program} {declared_version()}\n"
    assert done.stderr == "[] 0\n"


def test_importing_a_package_stays_cheap():
    code = (
        "import sys, datagen, obpose, benchmark; print({'importlib.metadata', 'tomllib', 'numpy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
