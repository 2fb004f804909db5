# Everything a developer does, each in one word: "make" lists them.
#
# The environment is made by tools/setup_environment.py; docs/adr/0001-ros-from-pypi.md says why and how.

# The Python that the environment is made with; empty: one that fits, see tools/fitting_python.sh.
PYTHON ?=
ifdef ROS_DISTRO
DISTRO ?= $(ROS_DISTRO)
VENV := .venv
else
DISTRO ?= jazzy
VENV := .venv$(if $(filter-out jazzy,$(DISTRO)),-$(DISTRO))
endif
BIN := $(CURDIR)/$(VENV)/bin
# Workers among which the tests are divided: one for each core, and one while others wait for nodes.
JOBS ?= $(shell echo $$(($$(nproc) + 1)))

# Folder for the results of the demonstration.
OUT := out/demo

# Runs a command inside the environment. Nodes talk to each other on this machine and to nobody else: not to another
# run (hence a domain of its own, by DRIVE_ID_DOMAIN or by chance) and not to a robot in the same network.
DRIVE_ID_DOMAIN ?= $(shell echo $$(($$$$ % 101 + 1)))
RUN := env PATH="$(BIN):$$PATH" ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=$(DRIVE_ID_DOMAIN)
# The ROS 2 wheels hold Fast DDS only, whatever another ROS 2 was told to use.
RUN += $(if $(ROS_DISTRO),,RMW_IMPLEMENTATION=rmw_fastrtps_cpp)
ifdef ROS_DISTRO
# The messages built in the environment come before those of a workspace that happens to be sourced as well.
RUN += LD_LIBRARY_PATH="$(CURDIR)/$(VENV)/lib:$$LD_LIBRARY_PATH" \
       PYTHONPATH="$$(echo "$(CURDIR)/$(VENV)"/lib/python3*/site-packages):$$PYTHONPATH"
COLCON := $(RUN)
else
# ROS 2 from the Python package index needs nothing sourced to run, but this to be built against.
COLCON := $(RUN) AMENT_PREFIX_PATH="$(CURDIR)/$(VENV)" CMAKE_PREFIX_PATH="$(CURDIR)/$(VENV)"
endif
# colcon as a program of this environment's Python, which has the dependencies, wherever colcon itself is installed.
COLCON += python "$$(PATH="$(BIN):$$PATH" command -v colcon)" --log-base log/$(DISTRO)
BASES := --build-base build/$(DISTRO) --install-base install/$(DISTRO)

# What a test is long for (pyproject.toml), and which of them the second command of the README leaves out.
LONG := accuracy or browser or process or slow
# Tests that need no fit, node, process or browser.
QUICK := $(addprefix test/core/,accumulation experiment maps numerics paper signals test_frames.py) test/files test/reporting/web \
         $(patsubst %,test/test_%.py,changelog config imports message_texts messages quantity settings suite types)
PYTEST := DRIVE_ID_REQUIRE_ROS=1 PYTHONDONTWRITEBYTECODE= python -m pytest

.PHONY: help setup demo check quick test test-all test-rest bench population safety fuzz endure lint ament docs coverage package colcon clean

help: ## list these targets
	@echo "make TARGET [DISTRO=jazzy|kilted] [PYTHON=python3.13]"
	@sed -n 's/^\([a-z-]*\):.*## /  \1\t/p' Makefile | expand -t 12

setup: ## make or update the environment (.venv, or .venv-DISTRO): ROS 2, dependencies, messages, drive_id
	@python=$$(sh tools/fitting_python.sh $(PYTHON)) && "$$python" tools/setup_environment.py --venv $(VENV) --distro $(DISTRO)

demo: setup ## simulate a drive, identify it, and leave the results in out/demo: make demo ARGS=--free-shaft
	@$(RUN) bash examples/demo.sh $(OUT) $(ARGS)

check: setup ## before each commit: lint, and the tests that need no fit, node, process or browser
	@$(MAKE) --no-print-directory --output-sync=target -j2 lint quick

quick: setup
	@$(RUN) $(PYTEST) -q -n $$(nproc) --dist loadscope -m "not ($(LONG))" $(QUICK) $(ARGS)

test: setup ## every module, command, node, page and format once (JOBS=0: in one process): make test ARGS="-k bag"
	@$(RUN) $(PYTEST) -n $(JOBS) --dist loadscope -m "not ($(LONG)) or essential" $(ARGS)

test-all: setup ## all tests: accuracy of many drives, faults of processes, and browsers as well
	@$(RUN) $(PYTEST) -n $(JOBS) --dist loadscope $(ARGS)

test-rest: setup ## what test-all has beyond test
	@$(RUN) $(PYTEST) -n $(JOBS) --dist loadscope -m "($(LONG)) and not essential" $(ARGS)

bench: setup ## run the benchmarks
	@$(RUN) python benchmarks/run.py $(ARGS)

population: setup ## fit 300 random drives and compare with the truth: make population ARGS="--seed 2", ARGS="--only 17"
	@$(RUN) python benchmarks/population.py $(ARGS)

safety: setup ## measure reaction times to trouble, ten times each: make safety ARGS="--rounds 0 --scripts 200"
	@$(RUN) python benchmarks/safety.py $(ARGS)

fuzz: setup ## try damaged and hostile inputs for a minute: make fuzz ARGS="--seconds 300"
	@$(RUN) python benchmarks/fuzz.py $(ARGS)

endure: setup ## identify live for hours, with many requests and kills: make endure ARGS="--only kills --rounds 30"
	@$(RUN) python benchmarks/endurance.py $(ARGS)

lint: setup ## check style and types, also of the pages' Python
	@$(RUN) ruff check
	@$(RUN) ruff format --check
	@$(RUN) mypy
	@$(RUN) python tools/snippets.py out/snippets
	@$(RUN) mypy out/snippets

ament: setup ## run the linters of ROS 2 from the Python package index
	@test -d out/ament || $(RUN) python -m pip install --quiet --disable-pip-version-check --target out/ament \
	    --requirement tools/requirements-ament.txt
	@$(RUN) PYTHONPATH="$(CURDIR)/out/ament:$$PYTHONPATH" python -m pytest -q test/test_ament_lint.py

coverage: setup ## run the tests and report which lines of core and files they reach: all tests must reach 95 %
	@$(RUN) DRIVE_ID_REQUIRE_ROS=1 python -m pytest -n $(JOBS) --dist loadscope -q --cov=drive_id.core --cov=drive_id.files \
	    --cov-report=term:skip-covered $(or $(ARGS),--cov-fail-under=95)

package: setup ## build wheel and sdist into out/dist, install each into an empty environment, and fit with it
	@$(RUN) bash tools/check_package.sh out/dist

docs: setup ## build the documentation, tutorials executed, into out/docs
	@$(RUN) python -m pip install --quiet --disable-pip-version-check --requirement docs/requirements.txt
	@$(RUN) python -m sphinx -E -W --keep-going -q -b html docs out/docs
	@$(RUN) python tools/check_site.py out/docs
	@echo "The documentation is in out/docs: open out/docs/index.html."

colcon: setup ## build, install and test both packages the way a ROS 2 workspace does
	@$(COLCON) build $(BASES)
	@DRIVE_ID_REQUIRE_ROS=1 $(COLCON) test $(BASES) --return-code-on-test-failure --event-handlers console_cohesion+
	@$(COLCON) test-result --test-result-base build/$(DISTRO)

clean: ## remove everything that was made, environments included
	rm -rf .venv .venv-* build install log out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find drive_id test tools benchmarks examples -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true
