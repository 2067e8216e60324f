# Two commands matter to a new user: `make demo` and `make test`. Both create .venv themselves.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PIP    := $(BIN)/python -m pip --quiet --disable-pip-version-check --require-virtualenv

.PHONY: torch demo test check bench clean

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
# a diagnosis: the verdict, the errors before and after on the part that no fit saw, and where the pictures are.
WITH ?= profiles/effects/modules_heat.toml
demo: $(STAMP)
	$(BIN)/hil run profiles/loads/battle_40h.csv --virtual --lockstep --diagnose end $(if $(WITH),--with $(WITH))

# Two workers: many tests wait for clocks, and a file's fixtures (a rig, a run) are made once.
test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/hil bench twin --quick
	$(BIN)/hil bench fit --quick
	$(BIN)/hil bench paper --quick

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
