# make train  - train the shared NAF policy on the paper's scenario, evaluate it, write the report
# make check  - linters, import contract, type checker, the tests that neither train nor take long
# make test   - the same with all tests that take less than a minute
# make trials - the tests that take minutes: what `make test` has a share of, whole
# make test-lowest, make test-newest - the tests with the lowest and the newest versions that pyproject.toml allows,
#                each in a virtual environment of its own: .venv-lowest, .venv-newest
# make coverage - the lines of marl_lanes that the tests of `make test` run; kernels count where they are interpreted
# make mutation - small faults put into naf/ and traffic/, and which of them the tests let pass: hours (ARGS="--share 0.1": less)
# make zoo - train the policies of marl_lanes/zoo/ anew, measure them, write their files and the index: a quarter of an hour
#            (ARGS="--processes N": N trainings at a time)
# make docs - the documentation as a site, in site/, which needs no server and no network (.venv-docs)
# make figures - draw the figures of docs/ anew, in a few minutes
# make reproduction - train with the values of the paper, all seeds, and write docs/reproduction.md; hours, goes on when interrupted
# make neighbours - the examples of other people's learners, each in a virtual environment of its own with pinned versions;
#                   make neighbour-rllib_ppo is one of them
# make benchmark - compare speed: one environment with other simulators, batches with a bare kernel, an update with bare PyTorch,
#                  pictures with highway-env's
# Each sets up .venv when it is missing or out of date.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN ?= runs/paper
ARGS ?=

# A file of tests stays in one process, which shares its trainings; files with long tests are first.
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder
# What `coverage` runs with interpreted kernels: a test that simulates many roads would take minutes.
INTERPRETED := -m "not (training or slow or long)" tests/traffic/test_golden.py tests/traffic/test_readout.py \
	tests/traffic/test_parameters.py tests/traffic/driving/test_gap_seeking.py tests/traffic/flow/test_collisions.py \
	tests/traffic/following/test_idm.py tests/traffic/machine tests/traffic/road/test_geometry.py \
	tests/traffic/road/test_motion.py tests/traffic/roles
# What stands before the tests of `check` and `test`, side by side.
MAKEFLAGS += --jobs=2

.PHONY: train check test test-lowest test-newest trials coverage mutation lint types kernels zoo docs figures reproduction \
	neighbours environments benchmark clean

train: $(VENV)/installed
	$(BIN)/python agents/naf/train.py output=$(RUN) $(ARGS)

check: lint types kernels
	$(PYTEST) -m "not (training or ray or slow)"

test: lint types kernels
	$(PYTEST)

# Other linters and type checkers say other things: these two run the tests alone.
test-lowest test-newest: test-%: .venv-%/installed
	NUMBA_CACHE_DIR=$(CURDIR)/.venv-$*/kernels .venv-$*/bin/python -m pytest --numprocesses auto --dist loadfile \
		--no-loadscope-reorder

.venv-%/installed: pyproject.toml constraints-%.txt
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --constraint constraints-$*.txt --editable '.[dev]'
	touch $@

# The site is made of the sources: its environment needs none of the package's dependencies.
docs: .venv-docs/installed
	.venv-docs/bin/python -m mkdocs build --strict

.venv-docs/installed: pyproject.toml constraints.txt
	test -x .venv-docs/bin/python || $(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]\
		["optional-dependencies"]["docs"], sep="\n")' > .venv-docs/requirements.txt
	.venv-docs/bin/python -m pip install --quiet --constraint constraints.txt --requirement .venv-docs/requirements.txt
	touch $@

trials: kernels
	$(PYTEST) --long -m long

# All tests with compiled kernels, whose lines do not count; then those of the traffic that are
# quick enough where kernels are interpreted.
coverage: kernels
	$(BIN)/python -m coverage erase
	$(BIN)/python -m coverage run -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest --numprocesses 0 $(INTERPRETED)
	$(BIN)/python -m coverage combine
	$(BIN)/python -m coverage report

mutation: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[mutation]'
	$(BIN)/python tests/mutation.py $(ARGS)

types: $(VENV)/installed
	$(BIN)/mypy

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

# Compiled once, before several processes would each do it.
kernels: $(VENV)/installed
	$(BIN)/python -c "from marl_lanes import Simulator; Simulator('paper').reset()"

zoo: $(VENV)/installed
	$(BIN)/python agents/zoo/make.py $(ARGS)

figures: $(VENV)/installed
	$(BIN)/marl-lanes followers --policy tuned-cascade --scenario dense \
		--figure docs/figures/followers.svg --figure docs/figures/followers.png
	$(BIN)/marl-lanes record tuned-cascade --scenario yielding --follow changer_7 --start 39 --seconds 9 \
		--span 150 --size 800x500 --out docs/figures/highway.gif
	$(BIN)/marl-lanes followers zoo:interactive --scenario interactive --followers neutral adversarial learned:zoo:adversary \
		--maneuvers 100 --figure docs/figures/tutorial_gap.svg --figure docs/figures/tutorial_gap.png
	$(BIN)/marl-lanes record zoo:interactive --scenario interactive --followers neutral learned:zoo:adversary \
		--out docs/figures/tutorial_adversary.png
	$(BIN)/python docs/programs/life.py --figure docs/figures/life.svg --figure docs/figures/life.png
	$(BIN)/python agents/memory/recognise.py --output build/recognition.json \
		--figure docs/figures/recognition.svg --figure docs/figures/recognition.png
	$(BIN)/python agents/adversary/ratings.py docs/league/ratings.json \
		--figure docs/figures/ratings.svg --figure docs/figures/ratings.png
	$(BIN)/python benchmarks/convergence.py \
		--figure docs/figures/convergence.svg --figure docs/figures/convergence.png
	$(BIN)/python docs/programs/curves.py docs/curves/*.csv \
		--figure docs/figures/neighbours.svg --figure docs/figures/neighbours.png

reproduction: $(VENV)/installed
# Hours of training, for docs/reproduction.md and these figures:
#     docs/figures/reproduction_loss.svg docs/figures/reproduction_loss.png
#     docs/figures/reproduction_returns.svg docs/figures/reproduction_returns.png
#     docs/figures/reproduction_models.svg docs/figures/reproduction_models.png
#     docs/figures/reproduction_maneuver_touch.svg docs/figures/reproduction_maneuver_touch.png
#     docs/figures/reproduction_maneuver_paper.svg docs/figures/reproduction_maneuver_paper.png
	$(BIN)/python agents/naf/reproduce.py --processes 2 --figures docs/figures --docs docs/reproduction.md

NEIGHBOURS := $(filter-out package,$(basename $(notdir $(wildcard docs/examples/environments/*.txt))))

neighbours: $(NEIGHBOURS:%=neighbour-%)

$(NEIGHBOURS:%=neighbour-%): neighbour-%: .venv-%/installed
	EXAMPLE=$* .venv-$*/bin/python -m pytest tests/integrations tests/test_examples.py

# Their versions clash with those of the package's trainings, which the examples do without. Byte code is left to the
# imports: they need little of what is installed.
environments: $(NEIGHBOURS:%=.venv-%/installed)

.venv-%/installed: docs/examples/environments/%.txt docs/examples/environments/package.txt pyproject.toml
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --no-compile --requirement $<
	.venv-$*/bin/python -m pip install --quiet --no-compile --no-deps --editable .
	touch $@

benchmark: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[benchmark]'
	$(BIN)/python benchmarks/single_env.py $(ARGS)
	$(BIN)/python benchmarks/batched_env.py $(ARGS)
	$(BIN)/python benchmarks/start.py $(ARGS)
	$(BIN)/python benchmarks/naf_update.py $(ARGS)
	$(BIN)/python benchmarks/policy_step.py $(ARGS)
	$(BIN)/python benchmarks/rendering.py $(ARGS)

$(VENV)/installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv-* build dist site .coverage .coverage.* .hypothesis .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
