# Commands of the repository. `make` alone lists them.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

CARGO ?= cargo
PYTHON ?= python3
DEVICE ?= auto
TARGET := $(or $(CARGO_TARGET_DIR),target)
# A gate that quietly updates the lock file tests something else than what was committed.
LOCKED := $(if $(CI),--locked)
# Files that speed up a second build take two gigabytes of the disk; CI builds once. In few large parts crates take less time in all.
ifdef CI
export CARGO_INCREMENTAL ?= 0
export CARGO_PROFILE_DEV_CODEGEN_UNITS ?= 4
endif

# Arguments of `octopus train` or `octopus bench`, as in: make train ARGS="--preset paper"
ARGS ?=

LIBTORCH_DIR = $(or $(LIBTORCH),.libtorch)
# Looked up when a recipe runs, after set-up: a libtorch with CUDA asks for the learner's feature.
FEATURES = $(shell test -e "$(LIBTORCH_DIR)/lib/libtorch_cuda.so" && echo "--features learner/cuda")

# How long each fuzz target runs, and which do: all by default. bash has a SECONDS of its own, which it
# does not export, so only a given one is taken.
FUZZ_SECONDS = $(if $(filter command line environment,$(origin SECONDS)),$(SECONDS),60)
FUZZ_TARGETS ?=

# $(call step,heading,command): runs one step of a longer list and says how long it took.
define step
@printf '\n==> %s\n' $(1); start=$$SECONDS; $(2) || { status=$$?; printf '==> %s: FAILED\n' $(1); exit $$status; }; \
	printf '==> %s: %d s\n' $(1) $$((SECONDS - start))
endef

.PHONY: help
help: ## list the commands
	@sed -nE 's/^([a-z-]+):[^#]*## (.*)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 20

.PHONY: setup
setup: libtorch ## fetch libtorch, and what the page is built with (once; DEVICE=cpu or DEVICE=cuda overrides the detection)
	@$(PYTHON) deploy/setup.py page || $(PAGELESS)

.PHONY: libtorch
libtorch:
	@$(PYTHON) deploy/setup.py $(if $(filter-out auto,$(DEVICE)),--device $(DEVICE))

.PHONY: venv
venv: ## install the Python packages of the cross-checks (once)
	@$(PYTHON) deploy/setup.py venv

.PHONY: venv-benches
venv-benches: ## install the Python packages of the benchmarks' peers (once)
	@$(PYTHON) deploy/setup.py benches

.PHONY: venv-wheel
venv-wheel:
	@$(PYTHON) deploy/setup.py wheel

# For any Python from 3.10 on; it needs neither libtorch nor our programs.
.PHONY: wheel
wheel: venv-wheel ## build the simulator for Python: a wheel in target/wheels
	.venv-wheel/bin/maturin build --release $(LOCKED) --manifest-path sim-worker/python/Cargo.toml --target-dir $(TARGET) --out $(TARGET)/wheels
	@echo 'install it: pip install $(TARGET)/wheels/spaceoctopus-*.whl'

.PHONY: wheel-test
wheel-test: wheel venv ## try the wheel itself; make test tries what was built beside the tests
	@$(CARGO) build $(LOCKED) --workspace --bins --tests $(FEATURES)
	SPACEOCTOPUS_WHEEL="$$(ls -t $(abspath $(TARGET))/wheels/spaceoctopus-*.whl | head -1)" $(CARGO) test $(LOCKED) --workspace --test it $(FEATURES) -- python::

# The page in a browser: types, then one script, one style and the simulator as a WebAssembly module, compressed.
# The programs look for it in this folder, which is beside theirs.
PAGE = $(abspath $(TARGET))/octopus-page
NODE = $(abspath .node/bin/node)
MODULE = $(abspath $(TARGET))/wasm32-unknown-unknown/release/browser.wasm
# Without the page all else works.
PAGELESS = { echo 'make: the page was not built, an older one stays; all else works, and `make page` tries again and says what is wrong' >&2; }

.PHONY: page
page: ## build the page that shows runs in a browser (part of make build)
	@$(PYTHON) deploy/setup.py page
	@cd coordinator/web && $(NODE) node_modules/typescript/bin/tsc --noEmit -p .
	@{ ! command -v rustup >/dev/null || rustup target add wasm32-unknown-unknown; } 2>/dev/null
	@# In the profile of the programs, so that macros are compiled once for both. But a browser, which has one lone number where they have
	@# lanes, takes a third longer for a step without the last level of optimisation.
	$(CARGO) build $(LOCKED) --release -p browser --target wasm32-unknown-unknown --config profile.release.package.simulator.opt-level=3
	@cd coordinator/web && $(NODE) build.mjs $(MODULE) $(PAGE)

.PHONY: programs
programs: libtorch
	@test -e $(TARGET)/release/octopus || echo 'compiling the programs, once: about 6 minutes on two cores'
	$(CARGO) build --release --bins -p coordinator -p learner -p sim-worker $(FEATURES)

.PHONY: build
build: programs ## build the programs, octopus, learner and sim-worker, and the page
	@$(MAKE) page || $(PAGELESS)

# What carries a run to other machines is large, and nobody who trains on one needs it.
.PHONY: gateway
gateway: build ## build the program that lets other machines help: octopus join
	$(CARGO) build --release --bins -p gateway

.PHONY: train
train: programs ## train, with ARGS="..." for octopus train
	@# A page that is there is kept current. A first one takes a minute that nobody who wants to train should wait for.
	@test ! -e $(PAGE) || $(MAKE) page || $(PAGELESS)
	$(TARGET)/release/octopus train $(ARGS)
	@# Quietly: the results of the training stay in sight.
	@test -e $(PAGE) || { echo 'building the page for browsers, once: about a minute' >&2; $(MAKE) page CARGO='$(CARGO) --quiet' >/dev/null || $(PAGELESS); }

.PHONY: bench
bench: build venv-benches ## measure this machine and the peers, with ARGS="..." for octopus bench
	$(TARGET)/release/octopus bench --peer $(ARGS)

.PHONY: test
test: setup venv page ## everything that must hold: format, lints, documentation, tests
	$(call step,'format',$(CARGO) fmt --all --check)
	$(call step,'lints',$(CARGO) clippy $(LOCKED) --workspace --all-targets --features fuzz/targets $(FEATURES) -- -D warnings)
	$(call step,'the simulator for browsers',{ ! command -v rustup >/dev/null || rustup target add wasm32-unknown-unknown; } && RUSTFLAGS='-D warnings' $(CARGO) check $(LOCKED) -p simulator -p browser --target wasm32-unknown-unknown)
	$(call step,'documentation',RUSTDOCFLAGS='-D warnings' $(CARGO) doc $(LOCKED) --workspace --no-deps $(FEATURES))
	# With the tests in one call: features of dependencies are united over what is built together, and
	# sim-worker, which takes minutes, would be built twice otherwise.
	$(call step,'programs',$(CARGO) build $(LOCKED) --workspace --bins --tests $(FEATURES))
	$(call step,'tests',$(CARGO) test $(LOCKED) --workspace $(FEATURES))

.PHONY: web-test
web-test: setup venv page ## try the page in Chromium
	@$(CARGO) build $(LOCKED) --workspace --bins --tests $(FEATURES)
	SPACEOCTOPUS_WEB_TEST=1 $(CARGO) test $(LOCKED) --workspace --test it $(FEATURES) -- page:: --nocapture

.PHONY: net-test
net-test: setup venv ## machines in networks of their own, cut off for long (root)
	@$(CARGO) build $(LOCKED) --workspace --bins --tests $(FEATURES)
	SPACEOCTOPUS_NET_TEST=1 $(CARGO) test $(LOCKED) --workspace --test it $(FEATURES) -- network:: --nocapture

# Arguments of the long chaos: kills at random, then restarts of workers and of the learner in one run, then
# damaged files, foreign environments, requests to a live run, attempts of another user at one, and a disk or a
# coordinator that stands still for one to two minutes a time. The last needs root and loop devices: without them
# it fails at the end, STANDSTILLS=0 leaves it out.
KILLS ?= 200
RESTARTS ?= 1000
LEARNER_RESTARTS ?= 50
DAMAGES ?= 100
ENVIRONMENTS ?= 100
REQUESTS ?= 5000
INTRUSIONS ?= 500
STANDSTILLS ?= 7
SEED ?= 1

.PHONY: chaos
chaos: setup ## attack runs at random and compare bits (SEED=1 KILLS=200 REQUESTS=5000 and more)
	@$(CARGO) build $(LOCKED) --workspace --bins --examples $(FEATURES)
	@$(TARGET)/debug/examples/chaos --seed $(SEED) --kills $(KILLS) \
		--worker-restarts $(RESTARTS) --learner-restarts $(LEARNER_RESTARTS) --damages $(DAMAGES) \
		--environments $(ENVIRONMENTS) --requests $(REQUESTS) --intrusions $(INTRUSIONS) \
		--standstills $(STANDSTILLS)

# Any value records what is found instead of checking it.
RECORD ?=

.PHONY: golden
golden: setup ## compare small rollouts, evaluations and trainings with their recorded digests
	@$(CARGO) build $(LOCKED) --workspace --bins --examples $(FEATURES)
	@$(TARGET)/debug/examples/golden $(if $(RECORD),--record)

.PHONY: guide
guide: setup ## write the pages of the guide that are made from the program
	@$(CARGO) build $(LOCKED) --workspace --bins --examples $(FEATURES)
	@$(TARGET)/debug/examples/guide

.PHONY: fuzz
fuzz: ## fuzz everything that reads bytes from outside (SECONDS=60 for each target)
	tests/fuzz/run.sh $(FUZZ_SECONDS) $(FUZZ_TARGETS)

# A clone of https://github.com/RustSec/advisory-db; without one known defects are not looked for.
ADVISORY_DB ?=
# With all features, among them that of the fuzz targets.
DENY = $(CARGO) deny --locked --all-features

.PHONY: deny
deny: ## check what is linked: bans, licences, sources (ADVISORY_DB=CLONE: known defects, too)
	@$(CARGO) deny --version >/dev/null 2>&1 || \
		{ echo 'cargo-deny is missing: cargo install cargo-deny --locked' >&2; exit 1; }
	@$(DENY) check bans licenses sources
ifneq ($(ADVISORY_DB),)
	@export GIT_CONFIG_COUNT=1 GIT_CONFIG_KEY_0='url.file://$(abspath $(ADVISORY_DB)).insteadOf'; \
		export GIT_CONFIG_VALUE_0=https://github.com/RustSec/advisory-db; \
		$(DENY) check advisories
endif

# Of the code that is unsafe or beside it what Miri can run: no other process, no shared memory, no vector
# instructions. It needs nightly: rustup component add miri rust-src --toolchain nightly
MIRI = MIRIFLAGS=-Zmiri-disable-isolation $(CARGO) +nightly miri test $(LOCKED) --target-dir $(TARGET)/miri

.PHONY: miri
miri: ## run portable lanes and byte views in an interpreter that knows the rules (needs nightly)
	@$(CARGO) +nightly miri --version >/dev/null 2>&1 || \
		{ echo 'Miri is missing: rustup component add miri rust-src --toolchain nightly' >&2; exit 1; }
	$(MIRI) -p simulator --lib scalar::
	$(MIRI) -p channels --lib line::

.PHONY: clean
clean: ## remove what was built; set-up and runs are kept
	$(CARGO) clean

.PHONY: distclean
distclean: clean ## remove what was built and what was set up; runs are kept
	rm -rf .node .node.tmp coordinator/web/node_modules .libtorch .libtorch.tmp .libtorch-old.tmp .venv-tests .venv-benches .venv-trainers .venv-wheel .cache
