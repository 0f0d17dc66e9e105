# Two commands: `make demo` and `make test`. Each installs what it needs into .venv first. `make experiments` redoes the
# paper: hours, and the same command goes on where it was stopped (docs/experiments.md). `make reference` and
# `make pictures` remake what docs/ shows.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

# Of the experiments: where they go, what the synthetic intervener watches, which BARN worlds are swept.
OUT     ?= out/experiments
SEEDS   ?= 0 1 2 3 4 5 6 7
WORLDS  ?= barn-like
METHODS := dwa,A,A+c,A+B,A+B+c,A+B+D,A+B+D+c

.PHONY: demo test experiments estimate reference pictures

demo: $(READY)
	$(BIN)/appli demo --out out/demo

test: $(READY)
	$(BIN)/python -m pytest

# --- experiments ---

SESSIONS := $(SEEDS:%=$(OUT)/sessions/%)
LEARNED  := $(OUT)/policies/.learned
SWEEP    := $(BIN)/appli sweep --methods $(METHODS) --policies $(OUT)/policies --seed 0
FAILED   := || test $$? -eq 1  # some trials failed: the report says which, the same command tries them again

experiments: $(LEARNED) | estimate
	$(SWEEP) --out $(OUT)/courses.sqlite --worlds training,unseen --runs 20 $(FAILED)
	$(SWEEP) --out $(OUT)/barn.sqlite --worlds '$(WORLDS)' --runs 12 $(FAILED)
	$(BIN)/appli report $(OUT)/courses.sqlite,$(OUT)/barn.sqlite --pick newest --policies $(OUT)/policies \
	    --worlds '$(WORLDS)' --out $(OUT)/report

estimate: $(READY)
	@$(BIN)/python -m scenarios.experiments $(OUT) '$(WORLDS)' '$(SEEDS)'

# A session is made beside the others and moved to them when it is complete.
$(SESSIONS): | estimate
	rm -rf $@.part
	$(BIN)/appli collect training --seed $(@F) --sessions 1 --out $@.part || test $$? -eq 1
	mkdir -p $(OUT)/interventions $(@D)
	rm -f $(OUT)/interventions/*-seed$(@F)-*.npz
	find $@.part -name '*.npz' -exec mv {} $(OUT)/interventions/ ';'
	rm -rf $@.part
	touch $@

$(LEARNED): $(SESSIONS) | estimate
	$(BIN)/appli train $(OUT)/interventions --all-methods --seed 0 --out $(OUT)/policies
	touch $@

# --- documentation ---

reference: $(READY)
	$(BIN)/python -m scenarios.reference docs/commands.md

# Drawn without a screen, by EGL or OSMesa. ONLY="robot drive" makes these alone; with all of them come the teleop page,
# where there is a chromium, and results/report, where BARN is the archive of the real worlds that its metrics come from.
BARN ?= barn_100.npz
pictures: export MUJOCO_GL ?= $(if $(filter Linux,$(shell uname)),egl)
pictures: $(READY)
	$(BIN)/python -m scenarios.pictures docs/pictures $(ONLY)
ifeq ($(ONLY),)
	! command -v chromium >/dev/null || PYTHONPATH=. $(BIN)/python docs/pictures/teleop_web.py
ifeq ($(wildcard $(BARN)),)
	@echo "results/report is left as it is; to remake it, too: make pictures BARN=barn_100.npz"
else
	$(BIN)/appli report results/courses.sqlite,results/barn.sqlite,results/barn-like.sqlite --policies results/policies \
	    --worlds '$(BARN)' --out results/report
endif
endif

# --- installation ---

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("appli-twin needs Python 3.11 or newer; try: make PYTHON=python3.11 $(MAKECMDGOALS)" if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $(READY)
