# Two commands do everything: `make demo` and `make test`. Both set up what they need.
PYTHON ?= $(shell for p in python3.14 python3.13 python3.12 python3.11 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
# the tests are shared out among so many processes, which wait twice as long as they compute: with two a core a
# fifth of the cores was idle; 0 runs all in one
PYTEST_WORKERS ?= $(shell expr 3 \* $$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 1))
VENV := .venv
BIN := $(VENV)/bin

.PHONY: help demo test check docs format lock wheels data-package deb image audit release clean

.DEFAULT_GOAL := help

help:
	@echo "make demo    an observatory without hardware centers five targets (KEEP=1 leaves the service running)"
	@echo "make test    lint, types, import contracts and the whole test suite"
	@echo "make check   lint, types and import contracts only"
	@echo "make docs    the documentation as a site, which wheels carry and a service shows at /help"
	@echo "make format  let ruff format the code"
	@echo "make lock    resolve the dependencies again into requirements.lock and requirements-runtime.lock"
	@echo "make wheels  the packages mountnav and mountnav-tycho2 in dist/, for pip and pipx"
	@echo "make deb     a Debian package in dist/, for this Debian's own Python"
	@echo "make image   a container image, by docker, podman or buildah"
	@echo "make audit   known faults of the locked packages; needs a network"
	@echo "make release wheel, sdist and SBOM of a tagged version in dist/, checked (docs/how-to/release.md)"

# The stamp stands for: environment made, locked dependencies in it, mountnav installed editable.
$(VENV)/.set-up: requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "mountnav needs Python 3.11 or newer; none was found. Name one: make PYTHON=/path/to/python3.12 ..."; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { echo "No virtual environment could be made (on Debian: apt-get install python3-venv)"; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

demo: $(VENV)/.set-up
	$(BIN)/mountnav demo $(if $(KEEP),--keep)

# The tests' own code is compiled once, beside the check, and not by each process that runs them; so is the index
# of the sky made that they search.
test: $(VENV)/.set-up
	@{ $(BIN)/python -m pytest --collect-only --quiet; \
		MOUNTNAV_CACHE=$${MOUNTNAV_CACHE:-$(CURDIR)/.cache} $(BIN)/mountnav catalog index; } > /dev/null 2>&1 & preparing=$$!; \
		$(MAKE) --no-print-directory check && { wait $$preparing || true; }
	$(BIN)/python -m pytest -m "not long" -n $(PYTEST_WORKERS) --dist worksteal $(PYTEST_ARGS)

check: $(VENV)/.set-up
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# NO_MKDOCS_2_WARNING: the theme's notice about its successor (docs/reference/dependencies.md)
docs: $(VENV)/.set-up
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

format: $(VENV)/.set-up
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# --no-emit-index-url: the locks name versions and hashes, never a host. The second one is for images and packages:
# what runs needs, and extras that nobody could add there later, in the same versions as it was tested with. mountnav-tycho2 is built from this checkout.
lock: $(VENV)/.set-up
	$(BIN)/uv pip compile pyproject.toml --group dev --group docs --universal --python-version 3.11 --generate-hashes \
		--upgrade --no-emit-index-url --no-emit-package mountnav-tycho2 --no-annotate --no-header --output-file requirements.lock
	$(BIN)/uv pip compile pyproject.toml --extra postgresql --extra tls --extra otel --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-package mountnav-tycho2 --no-annotate --no-header --constraint requirements.lock --output-file requirements-runtime.lock

wheels: data-package
	$(BIN)/python -m build --wheel --no-isolation --outdir dist .

data-package: $(VENV)/.set-up
	$(BIN)/python -m build --wheel --no-isolation --outdir dist deploy/tycho2

# by what is there; each of them reads deploy/Dockerfile. BASE=... names another image with Python in it
image:
	@for with in docker podman buildah; do \
		$$with info > /dev/null 2>&1 && exec $$with build $(if $(BASE),--build-arg BASE=$(BASE)) -f deploy/Dockerfile -t mountnav .; \
	done; echo "docker, podman or buildah is needed, and none answers"; exit 1

audit:
	@test -x build/audit/bin/pip-audit || { $(PYTHON) -m venv build/audit && build/audit/bin/python -m pip install --quiet --disable-pip-version-check pip-audit; }
	build/audit/bin/pip-audit --require-hashes --disable-pip -r requirements-runtime.lock

deb:
	deploy/debian/build dist

# What goes out is built from the tag alone, checked as an index shows it, and run once from an empty environment.
release: $(VENV)/.set-up
	@version=$$($(BIN)/python -c 'import tomllib; print(tomllib.load(open("pyproject.toml", "rb"))["project"]["version"])'); \
		test "$$(git describe --tags --exact-match 2>/dev/null)" = "v$$version" || \
		{ echo "HEAD is not tagged v$$version: tag it, or put the version in pyproject.toml right"; exit 1; }; \
		test -z "$$(git status --porcelain)" || { echo "There are changes that are not committed"; exit 1; }; \
		set -e; rm -rf dist build/release; \
		$(PYTHON) -m venv build/release; \
		build/release/bin/python -m pip install --quiet --disable-pip-version-check build cyclonedx-bom twine; \
		$(MAKE) --no-print-directory docs; \
		build/release/bin/python -m build --outdir dist .; \
		build/release/bin/python -m build --wheel --outdir dist deploy/tycho2; \
		build/release/bin/twine check --strict dist/*; \
		build/release/bin/cyclonedx-py requirements requirements.lock --of JSON -o dist/mountnav-$$version.sbom.json; \
		$(PYTHON) -m venv build/release/empty; \
		build/release/empty/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl; \
		build/release/empty/bin/mountnav --version; ls -l dist

clean:
	rm -rf $(VENV) dist build api/help/site .pytest_cache .mypy_cache .ruff_cache .hypothesis .cache
