# Builds its own environment in .venv: `make demo` and `make test` work on a machine that has make and CPython 3.10-3.13 only.

PYTHON ?= python3
# Distribution of ROS 2, jazzy or kilted, each with an environment of its own.
ROS ?= jazzy
VENV := .venv$(if $(filter-out jazzy,$(ROS)),-$(ROS))
REQUIREMENTS := requirements.txt requirements-$(ROS).txt
# The environment belongs to one interpreter, one place, one list of packages; another one is built anew.
KEY := $(shell $(PYTHON) -c 'import hashlib, os, sys; \
	texts = [open(name).read() for name in sys.argv[1:]]; \
	print(hashlib.sha256("".join([sys.version, os.getcwd(), *texts]).encode()).hexdigest()[:16])' $(REQUIREMENTS))
READY := $(VENV)/.ready-$(KEY)
CHECKS_READY := $(VENV)/.checks-$(KEY)-$(shell $(PYTHON) -c 'import hashlib; \
	print(hashlib.sha256(open("requirements-checks.txt", "rb").read()).hexdigest()[:16])')
INSTALLED := $(VENV)/.installed

# Traffic stays on this machine unless the user says otherwise.
ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export ROS_AUTOMATIC_DISCOVERY_RANGE
# Both are set by the ROS wheels for the interpreter they belong to; inherited from another one they lead to wrong libraries.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport PYTHONPATH

.PHONY: demo test quick coverage coverage-safety test-again fuzz faults mutate lint docs figures check-browser check-compilers check-export check-wheel check-colcon check-deb check-readme check-labs sbom bench env clean
demo: env
	$(VENV)/bin/hyst demo $(ARGS)

# Processes that run tests: one more than the two cores that the limit of time is meant for, as tests of nodes mostly wait for events.
WORKERS ?= 3
# Ends a process whose test hangs in a library that keeps Python's lock, so that no other timeout comes to work.
WATCHDOG = -o faulthandler_timeout=330 -o faulthandler_exit_on_timeout=true
# Without files of byte code each of the many processes of a run would compile all of the sources for itself.
test: env
	env -u PYTHONDONTWRITEBYTECODE $(VENV)/bin/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart=3 $(WATCHDOG) $(ARGS)

# The whole suite, with lines and branches of every process; `ARGS` names tests, of which the figures are lower.
coverage: $(CHECKS_READY) env
	$(VENV)/bin/python .ci/measure_coverage.py -n $(WORKERS) --dist loadfile $(WATCHDOG) $(ARGS)

# The core alone, without ROS and without what takes half a minute: for the minutes between two edits.
QUICK ?= test/chain test/physics test/test_files.py test/test_model_file.py test/test_yaml_files.py
quick: env
	env -u PYTHONDONTWRITEBYTECODE $(VENV)/bin/python -m pytest -n 2 --dist loadfile -m "not long_file" $(QUICK) $(ARGS)

# The safety path alone, every branch of which must be taken.
coverage-safety: $(CHECKS_READY) env
	$(VENV)/bin/python .ci/measure_coverage.py safety

# What failed in the last run, alone: tells what a busy machine did from what the code does. Nothing to run is a failure too.
test-again: env
	$(VENV)/bin/python -m pytest --last-failed --last-failed-no-failures none $(WATCHDOG) $(ARGS)

fuzz: env
	PYTHONPATH=. $(VENV)/bin/python test/fuzz $(ARGS)

# The n-th write, opened file, renaming, reading and allocation of each command fails, n = 1, 2, 3 … until the command passes.
faults: env
	$(VENV)/bin/python test/faults/sweep.py $(ARGS)

mutate: env
	$(VENV)/bin/python test/fuzz/mutations.py $(ARGS)

docs: $(CHECKS_READY) env
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --quiet --strict $(ARGS)

figures: env
	$(VENV)/bin/python docs/make_figures.py $(FOLDER) $(TO)

check-browser:
	.ci/browser.sh

check-compilers:
	.ci/compilers.sh

check-export: env
	$(VENV)/bin/python .ci/export.py

check-wheel: $(CHECKS_READY)
	$(VENV)/bin/python .ci/wheel.py

check-colcon: $(CHECKS_READY) env
	.ci/colcon.sh

check-deb: env
	.ci/debian.sh

check-readme: env
	$(VENV)/bin/python .ci/readme.py

check-labs: env
	.ci/labs.sh

lint: $(CHECKS_READY)
	$(VENV)/bin/python -m ruff check .
	$(VENV)/bin/python -m mypy
	$(VENV)/bin/python .ci/package.py
	$(VENV)/bin/python .ci/prose.py
	$(VENV)/bin/python .ci/headers.py

# What is installed, as a CycloneDX document, and whether its licenses fit.
sbom: $(CHECKS_READY) env
	mkdir -p build
	$(VENV)/bin/python -m cyclonedx_py environment --no-validate --output-reproducible --output-format JSON --output-file build/sbom.json
	$(VENV)/bin/python .ci/licenses.py

bench: env
	$(VENV)/bin/hyst bench $(ARGS)

env: $(READY) $(INSTALLED)

$(READY):
	@$(PYTHON) -c 'import sys; sys.exit(None if (3, 10) <= sys.version_info[:2] <= (3, 13) else \
	"Python %d.%d: CPython 3.10 to 3.13 is needed: make PYTHON=python3.12, say" % sys.version_info[:2])'
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes $(REQUIREMENTS:%=-r %)
	touch $(VENV)/COLCON_IGNORE $@

$(CHECKS_READY): $(READY)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements-checks.txt
	touch $@

$(INSTALLED): $(READY) setup.py setup.cfg evaluation/pyproject.toml examples/hysteretic_oscillators/pyproject.toml hyst_control/processes/node_list.py
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable . --editable evaluation --editable examples/hysteretic_oscillators
	$(VENV)/bin/python -m compileall -q hyst_control hyst_plant_sim evaluation examples
	$(VENV)/bin/python .ci/compile_kernels.py
	touch $@

clean:
	rm -rf .venv .venv-* build install log demo_out site .pytest_cache .ruff_cache .hypothesis *.egg-info
