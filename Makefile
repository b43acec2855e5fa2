# The workbook's commands. The first one that needs Python makes .venv with the pinned packages; the first one that tests
# adds to it what tests and benchmarks need.
# Another interpreter: make PYTHON=python3.12 ...; an environment of your own: make ENVIRONMENT=/path/to/it ...

PYTHON ?= python3
ARGS ?=

# A path as the shell takes it, blanks and all.
path = $(subst $() ,\ ,$(1))

ifdef ENVIRONMENT
BIN := $(call path,$(ENVIRONMENT))/bin
READY :=
TESTED :=
else
BIN := .venv/bin
READY := .venv/complete
TESTED := .venv/tests
endif

# The library, and the root for what stands beside the notebooks.
export PYTHONPATH := $(CURDIR)/lib:$(CURDIR)

# The settings of processor and process that numbers are made under; a build sets them for its kernels by itself.
PINNED := lib/workbook/pinned.env
UNDER_PINS = env $(shell grep -v '^\#' $(PINNED))

# nbval is for the notebooks, anyio is not used; loading them takes a second of every process.
# Files go to the workers whole, for their tests share what is dear to make, those of most tests first.
UNIT := tests -p no:nbval -p no:anyio --ignore=tests/committed --ignore=tests/browser \
	-n logical --dist loadfile
# How many notebooks nbval executes again: in the order of their names, from another one on each day.
RERUN ?= 3
AGAIN = $$(ls notebooks/*/*.ipynb | awk -v first=$$(($$(date +%s) / 86400 * $(RERUN))) -v count=$(RERUN) \
	'{ all[NR - 1] = $$0 } END { for (i = 0; i < count && i < NR; i++) print all[(first + i) % NR] }')
DAY := $(shell date +%Y%m%d)
# Property tests try the same examples in every run; with EXAMPLES=new those of the day, as `make dated` does.
EXAMPLES ?=
DRAWN := --hypothesis-profile=search --hypothesis-seed=$(DAY)

# A part of `make test`: $(1) its name, $(2) the command, run even if a part before it failed. How long each took and
# whether it passed is printed at the end.
PARTS := build/test-parts
part = @echo "$(1)"; begin=$$(date +%s); if $(2); then end=passed; else end=FAILED; fi; \
	printf '%-20s%6d s  %s\n' "$(1)" $$(($$(date +%s) - begin)) $$end >> $(PARTS)

# Kept bytecode halves the start of every worker, which reads all tests and checks all functions' types.
test quick: export PYTHONDONTWRITEBYTECODE :=

.PHONY: help figures choices settings contest test quick course lab site browser bench dated accept release doctor clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s  %s\n", $$1, $$2 }' Makefile

figures: $(READY) ## Build what is stale; ARGS="TOPIC/NOTEBOOK -p NAME=VALUE --jobs N --why"
	@$(BIN)/python -m workbook figures $(ARGS)

choices: $(READY) ## Try every choice that the papers leave open; ARGS="TOPIC --jobs N --budget MINUTES"
	@$(BIN)/python -m workbook choices $(ARGS)

settings: $(READY) ## Find which of these choices explain most printed numbers at once; ARGS="TOPIC --jobs N"
	@$(BIN)/python -m workbook settings $(ARGS)

contest: $(READY) ## Rank observers of flexible machines; ARGS="MY_OBSERVER.py --machine NAME"
	@$(BIN)/python -m stillwork contest $(ARGS)

test: $(TESTED) ## Style, types, unit tests, all notebooks, and what is committed against what they give now
	@mkdir -p build && rm -f $(PARTS)
	$(call part,style,$(BIN)/ruff check . && $(BIN)/ruff format --check .)
	$(call part,types,$(BIN)/python -m mypy)
	$(call part,unit tests,$(UNDER_PINS) $(BIN)/python -m pytest $(UNIT) $(if $(EXAMPLES),$(DRAWN)))
	$(call part,build,$(BIN)/python -m workbook figures)
	$(call part,notebooks,rm -rf build/nbval && $(UNDER_PINS) STILLWORK_OUTPUT="$(CURDIR)/build/nbval" \
		$(BIN)/python -m pytest $(AGAIN) --nbval --nbval-sanitize-with tests/nbval.cfg \
		--nbval-current-env --nbval-cell-timeout 600 -n logical --dist loadfile)
	$(call part,what is committed,$(UNDER_PINS) $(BIN)/python -m pytest tests/committed \
		-p no:nbval -p no:anyio -n logical --dist worksteal)
	@awk '{ all += $$(NF - 2); print } END { printf "%-20s%6d s\n", "all of them", all }' $(PARTS) && ! grep -q FAILED $(PARTS)

quick: $(TESTED) ## The unit tests that take less than a quarter of a second of CPU each
	$(UNDER_PINS) $(BIN)/python -m pytest $(UNIT) -m "not slow" $(ARGS)

course: $(TESTED) ## Run the solutions of the course's exercises
	$(UNDER_PINS) $(BIN)/python -m pytest tests/site/test_course.py -p no:nbval -p no:anyio $(ARGS)

lab: $(READY) ## Open JupyterLab on the notebooks, on this machine only
	JUPYTER_PREFER_ENV_PATH=1 $(BIN)/python -m jupyter lab --LabApp.default_url=/lab/tree/notebooks/index.ipynb \
		--ServerApp.root_dir=. --ServerApp.ip=127.0.0.1 $(ARGS)

site: $(READY) ## Write the static site to build/site/index.html; ARGS=--still leaves explorers as pictures
	@$(BIN)/python -m workbook site $(ARGS)

browser: $(TESTED) ## Write the site and check it and an explorer in Chromium (Debian: apt-get install chromium chromium-driver)
	@$(BIN)/python -m workbook site
	$(BIN)/python -m pytest tests/browser $(ARGS)

bench: $(TESTED) ## Measure speed beside named peers
	@for file in $$(grep -l 'make bench' benchmarks/*.py); do OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python $$file $(ARGS) || exit 1; done

dated: $(TESTED) ## Property tests on new examples, drawn from the day; DAY=20260101 for those of another
	@echo "examples of --hypothesis-seed=$(DAY)"
	$(UNDER_PINS) $(BIN)/python -m pytest $(UNIT) -m "hypothesis and not slow" $(DRAWN) $(ARGS) || { echo "the same examples again: make dated DAY=$(DAY)"; exit 1; }

accept: $(READY) ## Copy a build into notebooks/ and figures/, and into what follows from them
	@$(BIN)/python -m workbook accept

release: $(TESTED) ## Write wheel, site and archive to build/release
	@$(BIN)/python benchmarks/release.py

doctor: $(READY) ## Compare the environment with environment.txt
	@$(BIN)/python -m workbook doctor

clean: ## Remove what can be made again (not .venv)
	rm -rf build .pytest_cache .ruff_cache .hypothesis
	find lib contest notebooks tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# The folders that an editable install adds, from there on: Python reads them in the locale's encoding, and LC_ALL=C has
# no umlaut.
RELATIVE := import glob, os; \
	[file] = glob.glob(".venv/lib/python3.*/site-packages/_stillwork.pth") or [os.devnull]; \
	folders = open(file, encoding="utf-8").read().splitlines(); \
	print(*(os.path.relpath(each, os.path.dirname(file)) for each in folders), sep=chr(10), file=open(file, "w"))

# The last but two marks the environment as whole: one that was interrupted is made anew. What is compiled then is kept in
# build/kernels; whatever is missing there is compiled when it is called.
.venv/complete: environment.txt
	@$(call path,$(PYTHON)) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' || \
		{ echo "$(PYTHON) is not a Python 3.11, 3.12, 3.13 or 3.14; name one: make PYTHON=/path/to/python3.12"; exit 1; }
	@echo "Making .venv with the pinned packages (a minute or two, once)"
	@$(call path,$(PYTHON)) -m venv --clear .venv
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r environment.txt
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(call path,$(PYTHON)) -c '$(RELATIVE)'
	@touch .venv/complete
	@echo "Compiling the estimators and filters (half a minute to one, once)"
	@.venv/bin/python -m stillwork compile

.venv/tests: .venv/complete environment-tests.txt
	@echo "Adding to .venv what the tests need"
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r environment-tests.txt
	@touch .venv/tests
