# `make verify` and `make test` are all that a fresh machine with Python 3.11 to 3.13 needs; both set up .venv by themselves.

PYTHON ?= python3
VENV   ?= .venv
OUT    ?= evidence/two_mass
STUDY  ?= suite/studies/two_mass.toml
# three workers on two processors (some tests wait for an FMU to hang); the tests of a file stay together, so that what it sets up is set up once, and
# files go in their order: by their number of tests, the few long ones would come last, on one worker; assertions are taken as they are
# (rewriting them takes every worker some seconds), and what failed is run once more to say why
PYTEST_FLAGS ?= -n 3 --dist loadfile --no-loadscope-reorder --assert=plain

BIN := $(VENV)/bin
# twice quiet: errors only
PIP_FLAGS := --quiet --quiet --disable-pip-version-check
# The environment is ready if it was made from exactly these files; file dates mean nothing after a clone.
KEY   := $(shell cat requirements.lock pyproject.toml | cksum | tr ' ' '-')
READY := $(VENV)/ready-$(KEY)

.PHONY: help verify test slow foreign benchmark mutants lint format env compiler fmus foreign-env lock clean
.DEFAULT_GOAL := help

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

verify: env compiler ## set up, run the two-mass study (which builds its plant); leaves evidence/two_mass/report.html
	$(BIN)/slewcert verify $(STUDY) --out $(OUT) --force

test: env compiler ## set up and run the tests; says which groups it leaves out
	$(BIN)/pytest $(PYTEST_FLAGS) || { $(BIN)/pytest --last-failed --last-failed-no-failures none; exit 1; }

slow: env compiler ## the tests that take long
	$(BIN)/pytest -m slow

foreign: env compiler foreign-env ## the tests that need headless Chromium, Node, ziglang (100 MB), an emulator (20 MB), FMUs of other people (30 MB); the last three are installed
	$(BIN)/pytest -m foreign

benchmark: env compiler ## the measurements (installs CasADi to compare with)
	@$(BIN)/python -c 'import casadi' 2>/dev/null \
	  || $(BIN)/python -m pip install $(PIP_FLAGS) --require-hashes --requirement requirements-benchmark.lock
	$(BIN)/pytest -m benchmark

mutants: env ## change the checker in every small way and see that its tests notice (an hour)
	$(BIN)/python tests/mutants.py

lint: env ## ruff, pyright, import contracts
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright
	$(BIN)/lint-imports

format: env ## let ruff rewrite the sources
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

env: $(READY) ## the environment of requirements.lock, in .venv

$(READY):
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(not (3, 11) <= v <= (3, 13) and f"slewcert needs Python 3.11 to 3.13; $(PYTHON) is {v[0]}.{v[1]} (make PYTHON=... chooses another)")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install $(PIP_FLAGS) --require-hashes --requirement requirements.lock
	$(BIN)/python -m pip install $(PIP_FLAGS) --no-deps --no-build-isolation --editable .
	$(BIN)/python -m compileall -q relaxations fmus reports suite tests # also where nobody writes bytecode: every process would compile them anew
	@rm -f $(VENV)/ready-* && touch $@

# the same search as the build's own: $CC, cc, gcc, clang, then ziglang
compiler: env
	@test -n "$$CC" || command -v cc >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null \
	  || $(BIN)/python -c 'import ziglang' 2>/dev/null \
	  || { echo 'No C compiler here: installing ziglang (100 MB).'; \
	       $(BIN)/python -m pip install $(PIP_FLAGS) --require-hashes --requirement requirements-compiler.lock; }

fmus: env compiler ## build the shipped plants
	$(BIN)/slewcert fmus build

foreign-env: tests/foreign/node_modules/.package-lock.json tests/foreign/wheels/ready
	@$(BIN)/python -c 'import ziglang' 2>/dev/null \
	  || $(BIN)/python -m pip install $(PIP_FLAGS) --require-hashes --requirement requirements-compiler.lock
	@$(BIN)/python -c 'import unicorn' 2>/dev/null \
	  || $(BIN)/python -m pip install $(PIP_FLAGS) --require-hashes --requirement requirements-emulator.lock

tests/foreign/node_modules/.package-lock.json: tests/foreign/package-lock.json
	npm ci --prefix tests/foreign
	@touch $@

# Packages that carry FMUs, or make them: unpacked by the tests, never installed, so that what they ask for does not matter here.
tests/foreign/wheels/ready: requirements-fmus.lock | env
	rm -rf $(@D)
	$(BIN)/python -m pip download $(PIP_FLAGS) --no-deps --only-binary :all: --require-hashes --requirement $< --dest $(@D)
	@touch $@

lock: env ## resolve the dependencies anew (needs uv)
	uv pip compile pyproject.toml --extra dev --upgrade --output-file requirements.lock $(LOCK_FLAGS)
	echo ziglang | uv pip compile - --upgrade --output-file requirements-compiler.lock $(LOCK_FLAGS)
	echo unicorn | uv pip compile - --upgrade --output-file requirements-emulator.lock $(LOCK_FLAGS)
	echo casadi | uv pip compile - --constraint requirements.lock --upgrade --output-file requirements-benchmark.lock $(LOCK_FLAGS)
	printf '%s\n' $(FMU_PACKAGES) | uv pip compile - --no-deps --upgrade --output-file requirements-fmus.lock $(LOCK_FLAGS)

FMU_PACKAGES := gemseo-fmu crane-fmu component-model jsonpath-ng pythonfmu pythonfmu3

# names, versions and hashes for every supported Python and platform; no index address, whatever this machine is set up with
LOCK_FLAGS := --universal --python-version 3.11 --generate-hashes --no-config --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' --quiet

clean: ## remove the environment and everything made
	rm -rf $(VENV) evidence build dist tests/foreign/node_modules tests/foreign/wheels
