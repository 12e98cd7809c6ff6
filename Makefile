.DEFAULT_GOAL := help
PYTHON ?= python3.11
BIN := .venv/bin

help:         ## Show this list
	@grep -hE '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 16

.venv/.installed: pyproject.toml
	@echo "installing into .venv: 2 GB, some two minutes without a word"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[workers,dev,review]'
	@touch $@

install: .venv/.installed  ## Make .venv with the command counterpoint in it
	@echo "installed: $(BIN)/counterpoint; see it work: make demo"

.readers/labelling/.installed: tests/readers/requirements.txt
	@echo "installing programs that read exports into .readers/labelling: 0.6 GB"
	$(PYTHON) -m venv --clear .readers/labelling
	.readers/labelling/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps -r $<
	@touch $@

.readers/fiftyone/.installed:
	$(PYTHON) -m venv --clear .readers/fiftyone
	.readers/fiftyone/bin/python -m pip install --quiet --disable-pip-version-check fiftyone==1.22.1
	@touch $@

.readers/labelstudio/.installed:
	$(PYTHON) -m venv --clear .readers/labelstudio
	.readers/labelstudio/bin/python -m pip install --quiet --disable-pip-version-check label-studio==1.23.2
	@touch $@

readers: .readers/labelling/.installed  ## Programs of others that read exports in tests
fiftyone: .readers/fiftyone/.installed  ## FiftyOne, for its test; with a MongoDB, 1.2 GB
labelstudio: .readers/labelstudio/.installed  ## Label Studio, for its test; 1 GB

check: .venv/.installed    ## Format, lint, types, imports: what needs no server
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: check                ## The checks, then unit, contract and architecture tests
	@# Side by side, a process for each core: in each, libraries keep to one thread.
	OMP_NUM_THREADS=1 $(BIN)/pytest -q --numprocesses auto --maxprocesses 4 --dist worksteal

integration: .venv/.installed  ## Real processes and servers, killed and restarted; a bucket's day
	@# Two processes; what shares a server stays in one of them.
	$(BIN)/pytest -q -m integration --numprocesses 2 --dist loadgroup

browser: .venv/.installed  ## The review page in Debian's chromium
	$(BIN)/pytest -q -m browser

check-js:      ## Types of the page's modules, by npm's typescript
	npx --yes --package typescript@5 tsc -p tests/browser

golden: .venv/.installed   ## Compare every part with reference outputs: make golden DIR=../shared/golden
	$(BIN)/python -m tests.golden $(DIR)

fix: .venv/.installed      ## Format, and repair what can be repaired safely
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

demo: .venv/.installed     ## Simulated street logs, the whole system, a ranked table and pictures
	$(BIN)/counterpoint demo --out demo-output

bench: .venv/.installed    ## Where the time goes, beside floors measured in the same run
	$(BIN)/counterpoint bench pipeline

.PHONY: help install readers fiftyone labelstudio check check-js test integration browser golden fix demo bench
