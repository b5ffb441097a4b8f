# Every target sets up its own .venv; nothing else has to be installed but Python 3.11, pip and make.
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
export CHECK_PYTHON
# One thread a process: the numbers must not depend on how many cores a machine has.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# Tests start many processes, and without cached bytecode each of them compiles all modules.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-slow check bench docs clean

demo: .venv/.core
	$(BIN)/obpose-datagen --video --scenes 100 --resolution 64x64 --out demo/moving
	$(BIN)/obpose-datagen verify demo/moving
	$(BIN)/obpose-bench --model training-free --seeds 2 --data demo/moving --out demo/results
	$(BIN)/obpose-bench --model obpose --pretrained --fit-track moving --data demo/moving --out demo/results
	$(BIN)/obpose-datagen preview demo/moving --out demo/contact-sheet.png
	@echo
	@echo "The main job ran end to end:"
	@echo "  dataset        $(CURDIR)/demo/moving  (what it holds: README.md in it)"
	@echo "  leaderboard    $(CURDIR)/demo/results/leaderboard.csv"
	@echo "  report         $(CURDIR)/demo/results/report.html  (open it in a browser)"
	@echo "  contact sheet  $(CURDIR)/demo/contact-sheet.png"

# Files are spread over processes, each whole, as its tests share what they made. tests/conftest.py decides their order.
BESIDE := -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder --benchmark-disable

test: .venv/.dev
	$(BIN)/python -m pytest $(BESIDE)

test-slow: .venv/.dev
	$(BIN)/python -m pytest $(BESIDE) -m slow

check: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

bench: .venv/.dev
	$(BIN)/python -m pytest tests/perf -o addopts= --benchmark-columns=median,min,max,rounds --benchmark-group-by=group -s

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "The site: $(CURDIR)/site/index.html"

clean:
	rm -rf .venv demo build dist site *.egg-info

.venv/.core: pyproject.toml constraints.txt
	@$(PYTHON) -c "$$CHECK_PYTHON"
	$(PYTHON) -m venv .venv
	@# The CPU build first: PyPI's build for Linux on x86_64 brings 2.7 GB of CUDA packages.
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --index-url $(TORCH_INDEX) --retries 1 --timeout 20 \
		--no-deps torch || echo "No CPU build of PyTorch at $(TORCH_INDEX); pip takes the one of its own index."
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

.venv/.dev: .venv/.core
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

.venv/.docs: .venv/.core
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@
