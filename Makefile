# Two commands matter to a new user: `make demo` and `make test`. Both create .venv themselves.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PIP    := $(BIN)/python -m pip --quiet --disable-pip-version-check --require-virtualenv

PYTEST :=

.PHONY: torch demo test test-fast check docs bench results-check clean demo-tower

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) install -c constraints.txt -e ".[dev]"
	@$(MAKE) --no-print-directory torch
	touch $@

# torch is for the network calibrator alone. Its CPU build is taken where pip is told of one (find-links); the
# registry's build brings gigabytes of CUDA, so it is never fetched unasked: `pip install -e ".[ml]"` does that.
torch:
	@if $(PIP) download --no-index --no-deps -d $(VENV)/wheels $$(grep '^torch==' constraints.txt) >/dev/null 2>&1; \
	then $(PIP) install -c constraints.txt $(VENV)/wheels/torch*.whl && $(PIP) install -c constraints.txt -e ".[ml]"; \
	else echo "no CPU build of torch is at hand: the network calibrator is left out, all else works"; fi
	@rm -rf $(VENV)/wheels

# The 40-hour battle-time profile on the virtual rig, over real Modbus and CAN, in accelerated time. From 3.5 h on the
# power modules give off heat that the twin does not know of; `make demo WITH=` runs the healthy rig. The run ends with
# a diagnosis: the verdict, the errors before and after on the held-out segment, and where the pictures are.
WITH ?= profiles/effects/modules_heat.toml
demo: $(STAMP)
	$(BIN)/hil run profiles/loads/battle_40h.csv --virtual --lockstep --diagnose end $(if $(WITH),--with $(WITH))

# A month of a cooling-tower station that the program did not learn from: simulated historian, aligned record, twins of
# two cells, calibration, report. It ends with the errors against the hidden truth and a picture, in a few minutes.
TOWER := build/demo-tower
STATION := $(TOWER)/station/stationA
demo-tower: $(STAMP)
	rm -rf $(TOWER)
	$(BIN)/hil tower simulate --out $(TOWER)/station --months 1 --cells 2 --score
	$(BIN)/hil tower align $(STATION) --out $(TOWER)/record
	for cell in 1 2; do $(BIN)/hil tower commission $(TOWER)/record --cell $$cell --datasheet $(STATION)/datasheet.json \
		--points $(STATION)/commissioning.csv --out $(TOWER)/cell$$cell.toml || exit $$?; done
	$(BIN)/hil tower calibrate $(TOWER)/record --twin $(TOWER)/cell1.toml --twin $(TOWER)/cell2.toml \
		--labels $(STATION)/labels.csv --mode advisory --out $(TOWER)/out
	$(BIN)/hil tower report $(TOWER)/out --truth $(STATION)/truth.parquet \
		--labels $(STATION)/labels.csv --picture $(TOWER)/cell1.png

# Four workers on two cores: many tests wait for clocks. A file's fixtures (a rig, a run) are made once, and the files
# that take longest come first (tests/durations.txt, which `make test PYTEST=--write-durations` measures anew).
# The tests start hundreds of processes, so the sources are compiled to bytecode once before, also where the
# environment forbids Python to write it. `make check`, which collects the tests, leaves their bytecode as well.
XDIST := --dist loadfile --no-loadscope-reorder
test test-fast check: export PYTHONDONTWRITEBYTECODE :=
test: $(STAMP)
	$(BIN)/python -m compileall -q -j 0 hil drivers twin
	$(BIN)/python -m pytest -n 4 $(XDIST) $(PYTEST)

# For the inner loop, under two minutes: everything but the slow tests. A part: `make test-fast PYTEST=tests/drivers`.
test-fast: $(STAMP)
	$(BIN)/python -m pytest -n 2 $(XDIST) -m "not slow" $(PYTEST)

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.language
	$(BIN)/python -m pytest -q --collect-only --no-header -p no:cacheprovider tests > /dev/null || $(BIN)/python -m pytest -q --collect-only tests

# The documentation site, as docs/_build/index.html. A warning is an error. It needs no network, to build or to read.
docs: $(STAMP)
	rm -rf docs/_build
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build

bench: $(STAMP)
	$(BIN)/hil bench twin --quick
	$(BIN)/hil bench fit --quick
	$(BIN)/hil bench paper --quick

# Lists the pages of docs/results whose measured code has changed since, or that name no commit. Old ones are no error.
results-check: $(STAMP)
	$(BIN)/python -m hil.bench.measure.results_check

clean:
	rm -rf $(VENV) build docs/_build *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
