.DEFAULT_GOAL := help
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
USED := $(VENV)/.used
READY := $(VENV)/.ready
INSTALL ?= $(BIN)/python -m pip install --quiet --disable-pip-version-check
CONSTRAINTS ?= constraints.txt
PRESET ?= tiny

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

PACKAGES = @$(PYTHON) tools/with_clock.py $(VENV) $(INSTALL) $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable src/rayiou --editable

$(USED): pyproject.toml src/rayiou/pyproject.toml constraints.txt
	@$(PYTHON) tools/python_version.py
	@echo "Setting up $(VENV) (about two minutes, once)"
	$(PYTHON) -m venv $(VENV)
	$(PACKAGES) '.[plot,bag,pretrained]'
	@touch $@

$(READY): $(USED)
	@echo "Adding to $(VENV) what tests and development need (about a minute, once)"
	$(PACKAGES) '.[dev]'
	@touch $@

setup: $(READY)  ## Make .venv from pyproject.toml and constraints.txt

demo: $(USED)  ## Render streets, train, test on unseen streets, show table and images (FULL=1: every stage; PRESET=smoke: a minute or two)
	$(BIN)/python tools/demo.py $(PRESET) $(if $(FULL),--full)

PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal

test: $(READY)  ## Run the tests (COVERAGE=1: and print how many lines they ran)
	$(PYTEST) -m 'not whole_runs and not second_device and not faults and not cluster and not browser and not hostile' $(if $(COVERAGE),--cov)

test-runs: $(READY)  ## Run the long tests: whole trainings, killed and stopped work, every dataset, a second device
	$(PYTEST) -m 'whole_runs and not faults'

test-device: $(READY)  ## Train every row of the tables on a simulated second device, where device mistakes show
	$(PYTEST) -m second_device

test-faults: $(READY)  ## Record from a stand-in of a CARLA server that crashes, hangs and lies (minutes)
	$(PYTEST) -m faults

test-hostile: $(READY)  ## Open hundreds of hostile files by every command (HOSTILE_SEED=1: others, HOSTILE_ALL=1: a thousand; 15 minutes)
	$(PYTEST) -m hostile tests/hostile

test-cluster: $(READY)  ## Run multiruns on a Slurm of one node, training by torchrun and from S3 (INSTALL_SLURM=1: installs Slurm by apt-get)
	$(if $(INSTALL_SLURM),apt-get install --yes --quiet slurm-wlm munge)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m cluster

test-browser: $(READY)  ## Open the viewer's page in a headless Chromium (INSTALL_CHROMIUM=1: installs it by apt-get)
	$(if $(INSTALL_CHROMIUM),apt-get install --yes --quiet chromium)
	$(PYTEST) -m browser

test-typecheck: $(READY)  ## Run four folders of tests again, with every shape annotation checked
	$(BIN)/python tools/typecheck.py

lint: $(READY)  ## Check style and the directions of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PYTHONPATH=src $(BIN)/lint-imports --no-cache

types: $(READY)  ## Check types
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(READY)  ## Build the documentation into docs/_build, warnings are errors (DOCS_ONLINE=1: with links to other projects)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --builder html docs docs/_build
	@echo "docs/_build/index.html"

constraints: $(READY)  ## Write constraints.txt anew (UPGRADE=1: newest versions), look wheels up for every Python
	$(BIN)/python tools/constraints.py $(if $(UPGRADE),upgrade)
	$(BIN)/python tools/constraints.py check

bench: $(READY)  ## Measure speed and memory (tests/bench)
	@for script in tests/bench/bench_*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

SWEEP ?= comparison,semantic_temporal,refine,sketch,representation
SEEDS ?= 0
JOBS ?= 2
ARGS ?=

ablations: $(USED)  ## Train the rows of the paper's tables, then write them (SWEEP=rivals: of sweeps/rivals.yaml; SEEDS=0,1 JOBS=2 PRESET=small ARGS='key=value')
	@$(BIN)/python src/train.py --multirun +sweep=$(SWEEP) seed=$(SEEDS) preset=$(PRESET) \
	  hydra.launcher.n_jobs=$(JOBS) logger.group=ablations-$(PRESET) $(ARGS); code=$$?; \
	  $(BIN)/python src/report.py; [ $$code = 0 ] || echo "Not everything was trained: the reasons stand above the tables"; exit $$code

weights: $(USED)  ## Train the weights that come with the package, for hours, and pack them with a card each (NAME=tiny: one of tools/weights)
	$(BIN)/python tools/make_weights.py $(NAME)
	$(BIN)/python tools/model_zoo.py

pictures: $(READY)  ## Make the documentation's pictures (SURROUND_VIEW=folder: and those of a real car, docs/real_frames.md)
	$(BIN)/python tools/pictures.py $(SURROUND_VIEW)
	OMNIOCC_SCREENSHOTS=docs/pictures $(BIN)/python -m pytest -m browser tests/browser/test_screenshots.py

RUNS ?= runs

wandb-sync: $(READY)  ## Upload new offline W&B runs and the tables of the report (RUNS=runs)
	@$(BIN)/python -m omniocc.report.wandb.upload --runs $(RUNS)

dashboard-local: $(READY)  ## Show all W&B runs and stages of this machine in the terminal (RUNS=runs; q ends)
	@$(BIN)/python -m omniocc.report.wandb.local --runs $(RUNS)

dashboard: $(READY)  ## Save the W&B dashboard to the project omniocc (docs/how_to/dashboards.md)
	@$(BIN)/python -m omniocc.report.wandb.dashboard --runs $(RUNS)

.PHONY: help setup demo test test-runs test-device test-faults test-hostile test-cluster test-browser test-typecheck docs lint types constraints bench ablations wandb-sync weights pictures dashboard dashboard-local
