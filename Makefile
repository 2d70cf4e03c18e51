# make demo   the whole job on the embedded mannequin: photos, scans, registered meshes, errors, report
# make test   ruff, mypy, pytest
# Everything runs in .venv, made here from requirements.lock. PYTHON=python3.12 chooses another interpreter.

PYTHON ?= python3
CORES ?= 2
BIN := .venv/bin
DEMO := build/demo
BASELINE := reports/baselines/mannequin.json

.PHONY: help demo test lint format lock system-packages clean

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

.venv/ready: requirements.lock pyproject.toml
	@$(PYTHON) capture_eval/system_packages.py
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

system-packages:
	$(PYTHON) capture_eval/system_packages.py --install

demo: .venv/ready
	$(BIN)/capture-eval synthesize mannequin --out $(DEMO)/capture --poses 11 --views 16 --size 640x480 --cores $(CORES)
	$(BIN)/capture-eval run $(DEMO)/capture/manifest.yaml --out $(DEMO)/result --cores $(CORES)
	@if [ -f $(BASELINE) ]; then $(BIN)/capture-eval check $(DEMO)/result --baseline $(BASELINE) \
	    || echo "not the committed baseline: another processor or other packages, or something got worse"; fi
	@echo "report: $(CURDIR)/$(DEMO)/result/report/report.html"

# two test files at a time, one thread each: the pipeline in them is measured to repeat bit for bit
test: lint
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 \
	    $(BIN)/python -m pytest -q -n 2 --dist loadfile

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: .venv/ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# pinned versions for the demo, the tests and the containers, from what pyproject.toml allows today
lock:
	rm -rf build/lock
	$(PYTHON) -m venv build/lock
	build/lock/bin/python -m pip install --quiet --disable-pip-version-check ".[dev]"
	build/lock/bin/python -m pip freeze --exclude capture_eval > requirements.lock
	rm -rf build/lock

clean:
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
