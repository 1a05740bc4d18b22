# SPDX-License-Identifier: GPL-3.0-or-later
# Every target makes the environment it needs; `make` alone lists them.

PYTHON := .venv/bin/python
# Where OpenCL finds Intel's runtime, and where that finds its own libraries.
RUN := OCL_ICD_VENDORS=$(CURDIR)/.venv/opencl LD_LIBRARY_PATH=$(CURDIR)/.venv/lib $(PYTHON)

.PHONY: help environment demo test test-blender package lint docs clean

help:
	@echo "make demo          render the gallery into build/demo"
	@echo "make test          run the tests (no GPU, no root)"
	@echo "make test-blender  install the extension into a real Blender and test it there"
	@echo "make package       build and validate the extension's zip in build/"
	@echo "make bench-NAME    run tests/benchmarks/NAME.py, write build/bench/NAME.json"
	@echo "make lint          check style and types"
	@echo "make docs          build the documentation's site into build/docs, and check its links"
	@echo "make clean         remove what was built, the environment too"

environment:
	@python3 tests/setup/environment.py

demo: environment
	$(RUN) -m tests.demo

test: environment
	$(RUN) -m pytest

bench-%: environment
	$(RUN) -m tests.benchmarks.$*

package: environment
	$(PYTHON) -m tests.setup.package

test-blender: package
	$(PYTHON) -m tests.blender

lint: environment
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

# MkDocs' own notice about its next version is not of this project.
docs: environment
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

clean:
	rm -rf build wheels .venv
