# Every target sets up its own .venv; nothing else has to be installed but Python, pip and make. For Python 3.12 and
# later, PyBullet is built from source, which needs a C++ compiler: make demo PYTHON=python3.13
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
define CHECK_PYTHON
import sys
found = f"Python {sys.version.split()[0]} at {sys.executable}"
if sys.version_info < (3, 11):
    sys.exit(f"Found {found}; expected 3.11 or newer. Name another one with: make PYTHON=/path/to/python3.11")
print(f"Using {found}.")
endef
# What pip installs for the simulation: nothing more on 3.11, which has a wheel of PyBullet.
define CHOOSE_EXTRAS
import shutil, sys
from importlib.util import find_spec
if sys.version_info < (3, 12) or find_spec("pybullet"):
    sys.exit()
version = f"Python {sys.version_info.major}.{sys.version_info.minor}"
if any(map(shutil.which, ("c++", "g++", "clang++"))):
    sys.stderr.write(
        f"PyBullet has no wheel for {version}; pip builds it from source: about 7 CPU-minutes, 1 GB of memory.\n"
    )
    print("[simulate]")
else:
    sys.stderr.write(
        f"PyBullet has no wheel for {version}, and there is no C++ compiler to build it. All but simulation works.\n"
        "To simulate, install one (Debian, Ubuntu: apt-get install g++) and run `make clean`, or use Python 3.11.\n"
    )
endef
export CHECK_PYTHON CHOOSE_EXTRAS
# One thread a process: the numbers must not depend on how many cores a machine has.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# Tests start many processes, and without cached bytecode each of them compiles all modules.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-slow test-learning check bench docs clean

demo: .venv/.core
	$(BIN)/obpose-datagen --video --scenes 100 --resolution 64x64 --out demo/moving
	$(BIN)/obpose-datagen verify demo/moving
	$(BIN)/obpose-bench --model training-free --seeds 2 --data demo/moving --out demo/results
	$(BIN)/obpose-bench --model obpose-contact --pretrained --fit-track moving --data demo/moving --out demo/results
	$(BIN)/obpose-datagen preview demo/moving --out demo/contact-sheet.png
	@echo
	@echo "The main job ran end to end:"
	@echo "  dataset        $(CURDIR)/demo/moving  (what it holds: README.md in it)"
	@echo "  leaderboard    $(CURDIR)/demo/results/leaderboard.csv"
	@echo "  report         $(CURDIR)/demo/results/report.html  (open it in a browser)"
	@echo "  contact sheet  $(CURDIR)/demo/contact-sheet.png"

# Files are spread over processes, each whole, as its tests share what they made. tests/conftest.py decides their order.
BESIDE := -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --benchmark-disable
# One thread per process: processes with several threads slow each other down.
test test-slow test-learning: export OMP_NUM_THREADS := 1

test: .venv/.dev
	$(BIN)/python -m pytest $(BESIDE)

test-slow: .venv/.dev
	$(BIN)/python -m pytest $(BESIDE) -m slow --durations=10

test-learning: .venv/.dev
	$(BIN)/python -m pytest $(BESIDE) -m learning --durations=10

check: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

bench: .venv/.dev
	$(BIN)/python -m tests.perf.scene_costs moving static cluttered
	@echo "The first scene on a new machine, compilation included:"
	cache=$$(mktemp -d) && NUMBA_CACHE_DIR=$$cache $(BIN)/python -m tests.perf.scene_costs moving && rm -r $$cache
	$(BIN)/python -m tests.perf.command_costs
	$(BIN)/python -m tests.perf.dask_overhead
	$(BIN)/python -m tests.perf.growth
	$(BIN)/python -m tests.perf.training_rate --profile cpu --device cpu --batch 1 --size 64 --steps 5
	$(BIN)/python -m tests.perf.training_rate --profile cpu --device cpu --batch 4 --size 64 --steps 5
	$(BIN)/python -m tests.perf.training_rate --profile gpu --device cpu --batch 1 --size 32 --steps 2
	$(BIN)/python -m tests.perf.network_precision
	@# Last, because a goal that is not reached on this machine ends the recipe.
	$(BIN)/python -m pytest tests/perf -o addopts= --benchmark-columns=median,min,max,rounds --benchmark-group-by=group -s

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "The site: $(CURDIR)/site/index.html"

clean:
	rm -rf .venv demo build dist site *.egg-info

.venv/.core: pyproject.toml constraints.txt
	$(if $(strip $(PYTHON)),,$(error PYTHON is empty; expected an interpreter, 3.11 or newer. Leave PYTHON out, or name \
		one: make PYTHON=/path/to/python3.11))
	@$(PYTHON) -c "$$CHECK_PYTHON"
	$(PYTHON) -m venv .venv
	@# The CPU build first: PyPI's build for Linux on x86_64 brings 2.7 GB of CUDA packages.
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --index-url $(TORCH_INDEX) --retries 1 --timeout 20 \
		--no-deps torch || echo "No CPU build of PyTorch at $(TORCH_INDEX); pip takes the one of its own index."
	extras=$$($(BIN)/python -c "$$CHOOSE_EXTRAS") && \
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".$$extras"
	touch $@

.venv/.dev: .venv/.core
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

.venv/.docs: .venv/.core
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@
