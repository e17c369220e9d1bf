# Two commands: `make demo` and `make test`. Both set up what is missing.
.PHONY: demo test pages docs lint bench smoke setup setup-user browser clean

SHELL := /bin/bash
RUN := .venv/bin

setup:
	@bash pipelines/setup.sh

# Without the tools of tests, lint and docs: half the time.
setup-user:
	@bash pipelines/setup.sh user

demo: setup-user
	@PATH="$(CURDIR)/$(RUN):$$PATH" bash pipelines/demo.sh demo

# One numerical thread a test process: two processes of two threads each would fight for two cores.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 $(RUN)/python -m pytest -n auto --dist worksteal

test: setup
	$(PYTEST) -m "not pages" $(PYTEST_ARGS)

# Every command of README and docs, in small: half as long again as the tests.
pages: setup
	$(PYTEST) -m pages $(PYTEST_ARGS)

# The site of all pages and of the Python API, in site/; NO_MKDOCS_2_WARNING hides an advertisement.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(RUN)/mkdocs build

# Of scripts only names and parameters are checked, not types.
LOOSE := $(addprefix --disable-error-code=,arg-type assignment call-overload operator override return-value var-annotated) --no-warn-unused-ignores

lint: setup
	$(RUN)/ruff check pointsdf_cli tests benchmarks examples experiments pipelines
	$(RUN)/ruff format --check pointsdf_cli tests benchmarks examples experiments pipelines
	$(RUN)/mypy
	$(RUN)/mypy benchmarks/*.py pipelines/*.py pipelines/gpu/*.py experiments/*.py examples/*.py $(LOOSE)

# Without a browser the tests of the viewer's pages are skipped.
browser:
	@bash pipelines/browser.sh

smoke: setup
	PATH="$(CURDIR)/$(RUN):$$PATH" bash pipelines/smoke.sh

bench: setup
	@for file in benchmarks/bench_*.py; do echo "== $$file"; $(RUN)/python $$file || exit 1; done

clean:
	rm -rf .venv build dist demo *.egg-info
