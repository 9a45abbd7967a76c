# Two commands matter: `make demo` (see an avatar and its table) and `make test`. Both set everything up by themselves.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= demo
DEMO_ID ?= 1
DEMO_FRAMES ?= 600
DEMO_SIZE ?= 256
DEMO_STEPS ?= 4000
DEMO_METHOD ?= ggavatar_plus
DEMO_EVAL ?=
TEST_FLAGS ?=
MUTATION_FLAGS ?=
FAULT_FLAGS ?= --write docs/reliability.md
TABLE ?= table
TABLE_IDS ?= 1 2 3 4 5
TABLE_FRAMES ?= 600
TABLE_SIZE ?= 256
TABLE_METHODS ?= point_avatar flash_avatar gaussian_avatars ggavatar ggavatar_plus
TABLE_FLAGS ?= --preset fast --minutes 3 --jobs 2 --max-gaussians 20000
SUBJECT := $(DEMO)/subject
CAPTURE := $(DEMO)/capture
RUN := $(DEMO)/run

.PHONY: demo table test coverage mutations faults lint docs format bench clean-demo

demo: $(VENV)/installed
	@test -f $(SUBJECT)/README.txt || $(BIN)/ggavatar-demo --id $(DEMO_ID) --frames $(DEMO_FRAMES) --size $(DEMO_SIZE) --overwrite -o $(SUBJECT)
	@test -f $(CAPTURE)/preview.jpg || $(BIN)/ggavatar-prep $(SUBJECT)/video.mp4 --tracking $(SUBJECT)/tracking --masks $(SUBJECT)/masks \
		--head-model $(SUBJECT)/head.npz --subject subject-$(DEMO_ID) --size $(DEMO_SIZE) $$(test -e $(CAPTURE)/capture.json && echo --resume) -o $(CAPTURE)
	@$(BIN)/ggavatar-train $(CAPTURE) $(DEMO_METHOD) --steps $(DEMO_STEPS) $$(test -e $(RUN) && echo --resume) -o $(RUN)
	@$(BIN)/ggavatar-export $(RUN) --clip all --overwrite -o $(RUN)/exports/avatar.html
	@$(BIN)/ggavatar-eval $(RUN) --table $(DEMO_EVAL)
	@echo "see and move the avatar: open $(RUN)/exports/avatar.html in a browser"

table: $(patsubst %,$(TABLE)/captures/subject-%/preview.jpg,$(TABLE_IDS))
	@$(BIN)/ggavatar-sweep $(patsubst %,$(TABLE)/captures/subject-%,$(TABLE_IDS)) --methods $(TABLE_METHODS) \
		$(TABLE_FLAGS) -o $(TABLE)/runs

$(TABLE)/captures/subject-%/preview.jpg: $(VENV)/installed
	@test -f $(TABLE)/subjects/$*/README.txt || $(BIN)/ggavatar-demo --id $* --frames $(TABLE_FRAMES) --size $(TABLE_SIZE) \
		--overwrite -o $(TABLE)/subjects/$*
	@$(BIN)/ggavatar-prep $(TABLE)/subjects/$*/video.mp4 --tracking $(TABLE)/subjects/$*/tracking --masks $(TABLE)/subjects/$*/masks \
		--head-model $(TABLE)/subjects/$*/head.npz --subject subject-$* --size $(TABLE_SIZE) $$(test -e $(TABLE)/captures/subject-$*/capture.json && echo --resume) \
		-o $(TABLE)/captures/subject-$*

test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal $(TEST_FLAGS)

coverage: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal --cov --cov-report=term:skip-covered --cov-fail-under=90 $(TEST_FLAGS)

mutations: $(VENV)/installed-dev
	$(BIN)/python -m tests.mutations $(MUTATION_FLAGS)

faults: $(VENV)/installed-dev
	$(BIN)/python -m tests.faults --results build/faults $(FAULT_FLAGS)

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry .
	$(BIN)/vulture
	$(BIN)/codespell

docs: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "the site is in build/site; to read it with its search: $(BIN)/python -m http.server -d build/site"

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks rasterizer --json rasterizer.json

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "expected Python 3.11 or newer, found $$($(PYTHON) -V); run: make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	@touch $@ $(VENV)/installed
