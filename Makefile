# Two commands matter to a new user: `make demo` and `make test`. Both create .venv themselves.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: demo test check bench clean

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,ml]"
	touch $@

# The 40-hour battle-time profile on the virtual rig, over real Modbus and CAN, in accelerated time. From 3.5 h on the
# power modules give off heat that the twin does not know of; `make demo WITH=` runs the healthy rig.
WITH ?= profiles/effects/modules_heat.toml
demo: $(STAMP)
	$(BIN)/hil run profiles/loads/battle_40h.csv --virtual --lockstep $(if $(WITH),--with $(WITH))

test: $(STAMP)
	$(BIN)/python -m pytest

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/hil bench

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
