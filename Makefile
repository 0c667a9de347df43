# The commands of the project; README explains the first two.
VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin

.PHONY: demo test check data docs bench evidence blind lock clean

## demo: set up a virtual environment with the core alone and show I and T of a simulated tool, live
demo: $(VENV)/.run
	$(BIN)/highside demo

## install: set up a virtual environment with everything that a user may want
.PHONY: install
install: $(VENV)/.all

$(VENV)/.all: requirements.lock $(VENV)/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	touch $@

## test: set up everything the tests need and run all checks and tests; those that judge a pace or a delay beside no live ones
test: packages $(VENV)/.test
	@.ci/suites $(BIN)/python $(VENV)/logs make --no-print-directory check

## check: style, types, the contracts between the layers, and that what is imported is declared
check: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry src

## data: fetch the public recordings that the tests read (HIGHSIDE_DATA, else ../shared/data), checked by SHA-256
data:
	$(PYTHON) tests/data/fetch.py

## docs: build the documentation site, which `highside docs` shows and a wheel built afterwards carries
docs: $(VENV)/.test
	$(BIN)/python docs/site/build.py

.PHONY: packages
packages:
	bash .ci/packages

$(VENV)/.run: requirements-core.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-core.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $@

# the 240 packages by uv, of the same lock and hashes: 41 s of a processor, compiled, where pip takes 76. Where uv finds no registry (it
# does not read pip's settings) pip has its turn
$(VENV)/.test: requirements-test.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	sed -n '/^uv==/,/^[^ ]/{/^uv==/p;/^ /p;}' requirements-test.lock > $(VENV)/uv.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r $(VENV)/uv.txt
	$(BIN)/uv pip install --quiet --compile-bytecode --python $(BIN)/python --require-hashes -r requirements-test.lock \
	|| $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-test.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $(VENV)/.run $(VENV)/.all $@

## oldest: each extra by itself at the oldest versions that it allows (minutes; `test` tries all of them together)
.PHONY: oldest
oldest: packages $(VENV)/.test
	HIGHSIDE_OLDEST=each $(BIN)/python -m pytest -q tests/integration/test_install.py -k oldest

## bench: speeds side by side, as ratios
BENCHMARKS = bulk_attitude bulk_schedule codec_speed diagnosis_speed diagnosis_memory drift_speed live_cost many_tools broker_cost rotation_speed
bench: $(VENV)/.test
	for name in $(BENCHMARKS); do $(BIN)/python -m tests.bench.$$name || exit 1; done

## evidence: the long Monte-Carlo runs, every person's pages, the further cases of tests and a minute of each soak, figures printed.
## Monte Carlo is on WORKERS processes (0: all processors), its answers are kept in PARTS: interrupted, it goes on when called again
WORKERS ?= 0
PARTS ?= $(VENV)/evidence
OVER = --workers $(WORKERS) --parts $(PARTS)
evidence: $(VENV)/.test
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.calibration_montecarlo --sensors 1000 --first-seed 300000 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.schedule_coverage --sensors 600 --first-seed 400000 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.session_coverage 100 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.balance_coverage 54 $(OVER)
	$(BIN)/python -m studies.drift_scenarios --only "S1r elevation 0" --seeds 1 --no-rivals --efficiency 60 --consistency 100 --false-stops-h 10
	$(BIN)/python -m studies.drift_limit
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.watch_wells --wells 30 --departures 300 --first-seed 5000 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.watch_limits --wells 20 --first-seed 41000 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.watch_beyond --wells 20
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.fleet_lots --fleets 50 --tools 40 --first-seed 90000 $(OVER)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.fleet_lots --fleets 25 --tools 40 --first-seed 96000 --hidden laws $(OVER)
	$(BIN)/python -m studies.fleet_scale --job solve --sessions 1000 --kills 10 --ends 2
	PYTHONPATH=. $(BIN)/python tests/integration/people_walk.py
	$(BIN)/python -m pytest -q -m further tests/unit tests/integration
	HIGHSIDE_SOAK_S=60 $(BIN)/python -m pytest -q -s tests/integration/test_soak.py tests/integration/test_mqtt_faults.py tests/integration/test_mqtt_sigkill.py

## faults: the fault scenarios at their own numbers (about two hours), measured into docs/faults.md; FAULTS="--scenario 4".
## What held is kept in KEEP: interrupted, or with the million of damaged inputs not reached, it goes on when called again
FAULTS ?=
KEEP ?= $(VENV)/faults
.PHONY: faults
faults: packages $(VENV)/.test
	$(BIN)/python tests/faults/run.py --write --keep $(KEEP) $(FAULTS)

## blind: the sealed decks (hours), seeded by the commit that last changed the engine; BLIND="--seed mine --small" for a look
BLIND ?=
SCORE = OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.sealed.score $(BLIND)
blind: $(VENV)/.test
	$(SCORE)
	$(SCORE) --real
	for part in colour refit refusal; do \
	  for kind in null single pair open; do \
	    $(SCORE) --without $$part --only $$kind/poses || exit 1; \
	    $(SCORE) --without $$part --only $$kind/rotation --every 4 || exit 1; \
	  done; \
	done
	for kind in null single pair open; do \
	  $(SCORE) --rivals --only $$kind/poses || exit 1; \
	  $(SCORE) --rivals --only $$kind/rotation --every 12 || exit 1; \
	done

## open-world: laws that no library holds, with second sessions (hours), seeded as `blind` is; OPEN="--seed mine --every 20" for a look
OPEN ?=
.PHONY: open-world
open-world: $(VENV)/.test
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.open_world.score $(OPEN)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m studies.open_world.score $(OPEN) --groups law --rivals

## pictures: renew what the bench page in every state, and all other pages, are compared with (look before it is committed)
.PHONY: pictures
pictures: $(VENV)/.test
	HIGHSIDE_RENEW_PICTURES=1 $(BIN)/python -m pytest -q tests/integration/test_page_pictures.py -k three_widths
	HIGHSIDE_RENEW_PICTURES=1 $(BIN)/python -m pytest -q tests/integration/test_people_walk.py

## docs-pictures: renew the pictures of all pages in the docs (look at each before it is committed)
.PHONY: docs-pictures
docs-pictures: $(VENV)/.test
	$(BIN)/python docs/bench_screens.py
	$(BIN)/python docs/tools_page_pictures.py
	$(BIN)/python docs/pages_pictures.py

## axe: every state of every page by axe's rules, light and dark, narrow and wide (minutes)
## firefox: the main pages in Firefox, one half after the other (`--shots DIR` of the program keeps pictures)
## people: each person's pages in Chromium and Firefox, at three widths, with axe and the cable pulled (minutes)
.PHONY: axe firefox people
axe: $(VENV)/.test
	PYTHONPATH=. $(BIN)/python tests/integration/axe_walk.py
firefox: $(VENV)/.test
	PYTHONPATH=. $(BIN)/python tests/integration/firefox_walk.py
people: $(VENV)/.test
	PYTHONPATH=. $(BIN)/python tests/integration/people_walk.py

## viewers: 3,840 frames/s alone, then beside a hundred viewers of the tool's page, half of them deaf, a tenth hostile: two minutes
.PHONY: viewers
viewers: $(VENV)/.test
	$(BIN)/python -m tests.bench.viewers_cost

## words: collect the words of pages and documents into the catalogues of all languages, and compile these
.PHONY: words
BABEL = $(abspath $(BIN))/pybabel
words: $(VENV)/.test
	cd src/highside && $(BABEL) extract -k said_later -k said -k several:1,2 -F ../../.babel.cfg --no-location --project highside -o words/locale/highside.pot .
	cd src/highside && $(BABEL) update -D highside -i words/locale/highside.pot -d words/locale --no-fuzzy-matching --no-wrap
	cd src/highside && $(BABEL) compile -D highside -d words/locale && rm words/locale/highside.pot

## lock: pin every dependency with its hashes (needs uv)
lock:
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header --extra all --extra build pyproject.toml -o requirements.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header --extra build -c requirements.lock pyproject.toml -o requirements-core.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header --extra service --extra build -c requirements.lock pyproject.toml -o requirements-service.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header --all-extras pyproject.toml -o requirements-test.lock

## dist: the wheel and the sources into dist/; HIGHSIDE_SOURCE_URL=https://... makes pictures and links absolute
.PHONY: dist
dist: $(VENV)/.run
	$(BIN)/python -m hatchling build -d dist -t sdist -t wheel

## deb: the Debian package of the service into dist/ (needs debhelper)
.PHONY: deb
deb: $(VENV)/.run
	PYTHON=$(CURDIR)/$(BIN)/python packaging/deb dist

clean:
	rm -rf $(VENV) build dist src/highside/site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
