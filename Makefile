# Everything here runs inside .venv, which `make setup` builds from requirements.lock.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
SHELL := /bin/sh

PYTHON ?= python3
VENV := .venv
VENV_ROBOT := .venv-robot
BIN := $(VENV)/bin

POLICY ?= arm.pt
OUT ?= out/$(basename $(notdir $(POLICY))).onnx
HOURS ?= 1
ROBOTS ?= 32
SEED ?= 7
WORKERS ?= 2
SECONDS ?= 3600
ARGS ?=
# Tests of one file share fixtures: they stay in one process, of which there are as many as cores. Files start in
# alphabetical order: the many small ones of tests/robots come last, so that all processes end at about the same time.
TESTS := -m pytest -q -n auto --dist loadfile --no-loadscope-reorder
ARM := out/arm.onnx

# rsl-rl imports GitPython, which refuses to load where there is no git.
export GIT_PYTHON_REFRESH := quiet

PIP_INSTALL := -m pip install --disable-pip-version-check
# Hashes for everything, and wheels only: nothing unlocked is downloaded in order to build something.
LOCKED := --require-hashes --only-binary :all:
EDITABLE := --no-deps --no-build-isolation --editable .

.PHONY: help
help: ## list these targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# ---- environments ---------------------------------------------------------------------------------------------

.PHONY: setup setup-robot
setup: $(VENV)/.installed ## make .venv with everything that is locked (PYTHON=python3)
setup-robot: $(VENV_ROBOT)/.installed ## make .venv-robot: run, simulate, soak and test, without torch

# One rule for both environments: `.locked` holds the libraries, `.installed` this project on top of them. Of the larger
# one only what is used is compiled, when it is first imported: pip would compile all of it for a minute.
define environment
$(1)/.locked: $(2)
	@command -v $$(PYTHON) >/dev/null || { echo "error: PYTHON=$$(PYTHON): not found; Python 3.11 to 3.14 is needed" >&2; exit 2; }
	@$$(PYTHON) -c 'import sys; v = sys.version_info[:2]; (3, 11) <= v < (3, 15) or sys.exit("error: PYTHON=$$(PYTHON) is Python %d.%d, but 3.11 to 3.14 is needed: make $$(MAKECMDGOALS) PYTHON=python3.12" % v)'
	@echo "$(1): installing what $(2) locks ($(3))"
	@$$(PYTHON) -m venv $(1) || { rm -rf $(1); exit 2; }
	@$(1)/bin/python $$(PIP_INSTALL) --quiet $(4) $$(LOCKED) --requirement $(2)
	@touch $$@

$(1)/.installed: $(1)/.locked pyproject.toml
	@$(1)/bin/python $$(PIP_INSTALL) --quiet $$(EDITABLE)
	@touch $$@
endef
$(eval $(call environment,$(VENV),requirements.lock,6.5 GB: a few minutes,--no-compile))
$(eval $(call environment,$(VENV_ROBOT),requirements-robot.lock,1.1 GB: a minute))

# ---- the main job ---------------------------------------------------------------------------------------------

.PHONY: demo export run soak smoke shift nightly faults weekend train bench mutants attack margins fuzz
demo: setup ## export the arm's policy, run it for 10 s, soak 32 robots for 3 simulated minutes
	@mkdir -p out
	$(BIN)/policy-export --policy arm.pt --out $(ARM)
	@sync # a fresh installation is still being written to the disk, and ticks would come late for it
	$(BIN)/deploy-run --backend sim --policy $(ARM) --duration 10 --out out/run
	@$(BIN)/soak-test --policy $(ARM) --hours 0.05 --robots 32 --seed 7 --workers 2 --out out/soak; \
	status=$$?; echo "report: $(CURDIR)/out/soak/report.html"; exit $$status

export: setup ## write one ONNX file with its contract: POLICY=arm.pt [OUT=file.onnx]
	@mkdir -p out
	$(BIN)/policy-export --policy "$(POLICY)" --out "$(OUT)"

run: $(ARM) ## run the arm in simulation, in real time, until Ctrl-C (ARGS=...)
	$(BIN)/deploy-run --backend sim --policy $(ARM) --out out/run $(ARGS)

soak: $(ARM) ## soak the arm: HOURS=1 ROBOTS=32 SEED=7 WORKERS=2 (ARGS=...)
	$(BIN)/soak-test --policy $(ARM) --hours $(HOURS) --robots $(ROBOTS) --seed $(SEED) --workers $(WORKERS) --out out/soak $(ARGS)

# Profiles are described in eval/profiles.
smoke: ## under 3 minutes: for every pull request
shift: ## a working day of 32 arms
nightly: ## a working day of 64 arms
faults: ## every class of fault, often enough to show that 95 % of each are handled
weekend: ## a working day of 256 arms
smoke shift nightly faults weekend: $(ARM)
	$(BIN)/soak-test --policy $(ARM) --profile $@ --seed $(SEED) --workers $(WORKERS) --out out/$@ $(ARGS)

train: setup ## train the arm's policy from its recipe (ARGS=...)
	$(BIN)/policy-train --out out/train $(ARGS)

bench: $(ARM) ## measure the figures that the README quotes
	$(BIN)/python -m eval.bench $(ARGS)
	$(if $(ARGS),,$(BIN)/python -m policies.bench)

mutants: setup ## weaken each guard in turn: the judge must notice every time
	$(BIN)/python -m eval.mutants $(ARGS)

attack: setup ## try again what soak-attack has found: no hard event may be left (ARGS=...)
	$(BIN)/python -m eval.attack $(ARGS)

margins: setup ## do the margins of robot.toml cover what draws.toml allows? An hour (ARGS=...)
	$(BIN)/python -m eval.margins --workers $(WORKERS) $(ARGS)

fuzz: setup ## read mutated files of every kind: SECONDS=3600 (ARGS=...)
	$(BIN)/python -m eval.fuzz --table policies.fuzz.targets:TARGETS --seconds $(SECONDS) --seed $(SEED) $(ARGS)

$(ARM): policies/arm.pt robots/arm6/model.xml robots/arm6/robot.toml | setup
	@mkdir -p out
	$(BIN)/policy-export --policy arm.pt --out $@

# ---- tests and checks -----------------------------------------------------------------------------------------

SAFETY := deploy.safety,deploy.motion
SAFETY_TESTS := tests/deploy/safety tests/deploy/motion tests/deploy/operation/test_stop_explanation.py $(wildcard tests/deploy/test_runtime*.py)

.PHONY: test test-fast test-notorch cover cover-safety mutate check check-addresses
test: setup ## run all tests (ARGS=...)
	$(BIN)/python $(TESTS) $(ARGS)

test-fast: setup ## run the tests that take little time, in a minute or so: for work in between (ARGS=...)
	$(BIN)/python $(TESTS) -m "not slow" $(ARGS)

test-notorch: setup-robot ## run the tests that need no torch, where there is none
	$(VENV_ROBOT)/bin/python -c 'import importlib.util as u, sys; sys.exit("error: torch is installed here" if u.find_spec("torch") else 0)'
	$(VENV_ROBOT)/bin/python $(TESTS) $(ARGS)

cover: setup ## run all tests and list the lines that none of them reached
	$(BIN)/python -m coverage run -m pytest -q
	$(BIN)/python -m coverage report

cover-safety: setup ## run tests of the code that stops a robot; fails if they leave out a line or a branch of it
	$(BIN)/python -m coverage run --source $(SAFETY) -m pytest -q -m "not slow" $(SAFETY_TESTS)
	$(BIN)/python -m coverage report --fail-under 100

mutate: setup ## change the code that stops a robot in every mechanical way, and list the changes that no test notices
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m mutmut run --max-children $(WORKERS)
	$(BIN)/python -m mutmut results

check: setup check-addresses ## lint, format, types, import layers, addresses
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

check-addresses:
	@! grep -nE '://|^ *-[a-z-]*(index|find-links)' requirements.lock requirements-robot.lock \
		|| { echo "error: a lock file holds names, versions and hashes only" >&2; exit 1; }
	@! git grep -nIE 'https?://[^ ]*/simple' \
		|| { echo "error: a tracked file names a package registry" >&2; exit 1; }

# ---- upkeep ---------------------------------------------------------------------------------------------------

# Settings of this machine (another index, a folder of wheels) stay out: only the public registry is asked.
UV := env -u UV_FIND_LINKS -u UV_INDEX -u UV_INDEX_URL -u UV_DEFAULT_INDEX -u UV_EXTRA_INDEX_URL $(BIN)/uv
COMPILE := $(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	--no-emit-index-url --no-emit-find-links pyproject.toml

.PHONY: lock clean
lock: setup ## renew requirements.lock and requirements-robot.lock (ARGS=--upgrade)
	$(COMPILE) --all-extras $(ARGS) --output-file requirements.lock
	$(COMPILE) --extra eval --extra test --constraint requirements.lock --output-file requirements-robot.lock
	@$(MAKE) --no-print-directory check-addresses

clean: ## remove both environments, caches and out/
	rm -rf $(VENV) $(VENV_ROBOT) out build dist *.egg-info .coverage .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis mutants
	find robots deploy eval policies tests -name __pycache__ -type d -prune -exec rm -rf {} +
