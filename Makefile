# make train  - train the shared NAF policy on the paper's scenario, evaluate it, write the report
# make test   - linters, import contract, type checker, tests
# make benchmark - compare speed: one environment with other simulators, batches with a bare kernel, an update with bare PyTorch
# Each sets up .venv when it is missing or out of date.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN ?= runs/paper
ARGS ?=

.PHONY: train test benchmark clean

train: $(VENV)/installed
	$(BIN)/python agents/naf/train.py output=$(RUN) $(ARGS)

test: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

benchmark: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[benchmark]'
	$(BIN)/python benchmarks/single_env.py $(ARGS)
	$(BIN)/python benchmarks/batched_env.py $(ARGS)
	$(BIN)/python benchmarks/start.py $(ARGS)
	$(BIN)/python benchmarks/naf_update.py $(ARGS)
	$(BIN)/python benchmarks/policy_step.py $(ARGS)

$(VENV)/installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf build dist .coverage .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
