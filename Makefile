# make demo | test | docs | fuzz | bench | experiments; everything runs in .venv, made on first use with PYTHON.
PYTHON ?= python3
VENV := .venv
SECONDS := 600
SEED := 1
JOBS := 1
SCALE := 1
ARGS :=
AUDITED := tests/optdock/verification/test_conservative_advancement.py tests/optdock/verification/test_certify.py \
	tests/optdock/verification/test_trajectory_rules.py tests/optdock/timing/test_near_optimal.py \
	tests/optdock/planners/manoeuvres tests/smoothers/test_casadi_smoother.py tests/smoothers/test_tracking.py \
	tests/optdock/test_deformation.py tests/optdock/test_pipeline.py \
	tests/optdock/verification/test_search_for_proofs.py tests/optdock/controllers/test_mpc_program.py
# Tests that `make unit` leaves out: `make docs`, `make test-experiments` and `make test-ui` run them.
UNIT_LEFT_OUT := docs experiments browser
BENCHES := conversions smooth_path heartbeat dockings
BIN := $(VENV)/bin
ROS_DISTRO := kilted
ROS_WORKERS := 3
ROS_SUFFIX := $(addprefix -,$(filter-out kilted,$(ROS_DISTRO)))
ROS_VENV := .venv-ros$(ROS_SUFFIX)
ROS_BIN := $(ROS_VENV)/bin
ROS_WHEELS := ros/requirements$(ROS_SUFFIX).txt
# Left out on other distributions than Kilted, because it is the same there: the loop of control uses threads alone, and
# the others test the tools of the tests, the ends of the demo, and the commands and tables of the documentation. What
# exchanges messages, services, actions, parameters or transforms is tested on every distribution. `ROS_LEFT_OUT=` leaves
# nothing out.
ROS_LEFT_OUT := $(if $(ROS_SUFFIX),test_control_loop test_demo_ends test_docs test_harness)
ROS_STAMP := $(ROS_VENV)/.installed-$(shell $(PYTHON) --version | cat - pyproject.toml $(ROS_WHEELS) \
	ros/optdock_ros/setup.py | sha256sum | cut -c 1-16)
# The pip that comes with Python 3.11 takes twice the time of the present one; without the present one, it serves.
NEW_PIP := pip install --quiet --disable-pip-version-check --upgrade pip
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-for-demo
LIBRARY := optdock/_kernels.shared

# Compiled modules are kept also where the environment says otherwise: hundreds of processes import the same ones.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test check unit kernels test-kernels test-aarch64 test-experiments docs site ui-env test-ui report-check figures fuzz bench bench-manoeuvres bench-docking experiments ros-env ros-types ros-demo test-ros bench-ros clean
help:
	@echo "make demo         built-in docking scenario, start to finish, pictures in demo/"
	@echo "make test         the check of the product: ruff, mypy, import-linter, pytest with doctests"
	@echo "make kernels      the kernels in C compiled anew, after a change of their sources; needs a C compiler"
	@echo "make test-kernels  the kernels: tests with sanitizers, and tests that compare every call with the NumPy twin; one minute"
	@echo "make test-aarch64  the kernels compiled for aarch64, by a cross compiler, and run by an emulator: same results as here"
	@echo "make docs         the documentation and its tests: every snippet runs, warnings are errors; open site/index.html"
	@echo "make test-experiments  the tests of benchmarks, studies and the fuzzer"
	@echo "make test-ui      the page of optdock ui in Chromium, pictures in results/ui/: five minutes; skipped without Chromium"
	@echo "make report-check  a report opened in Chromium, pictures in results/report/; needs Chromium, ARGS='FILE.html' checks that file"
	@echo "make figures      the measured tables of the documentation against what their commands print now: hours;"
	@echo "                  ARGS='contact' those of commands with that word in them, ARGS='contact --write' puts new figures in"
	@echo "make fuzz         random problems against an independent oracle; SECONDS=600 SEED=1 JOBS=1, failures in results/fuzz/"
	@echo "make bench        benchmarks, tables on stdout"
	@echo "make bench-manoeuvres  from anywhere into the dock, tables on stdout, results/manoeuvres/; ARGS='--every 20'"
	@echo "make bench-docking  1,000 dockings to contact in each world, tables on stdout, results/docking/; ARGS='--count 50'"
	@echo "make ros-demo     a simulated robot docked by the ROS 2 server: recording and pictures in ros-demo/; no ROS needed"
	@echo "make test-ros     the ROS 2 package with a real rclpy, in an environment of its own (.venv-ros);"
	@echo "                  ROS_DISTRO=jazzy with that of Jazzy (.venv-ros-jazzy), also in ros-demo and bench-ros"
	@echo "make bench-ros    the ROS 2 servers measured: round trips, heartbeat, 100 dockings; BENCHES=dockings ARGS='--count 20'"
	@echo "make experiments  the numbered studies in experiments/, tables and charts in results/; SCALE=0.1 for a quick look,"
	@echo "                  JOBS=2 processes; on Nav2's maps and public parking cases too with OPTDOCK_DATA;"
	@echo "                  at full scale and without them the tables of the documentation are compared with the results"

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "optdock needs Python >= 3.10")'
	@echo "making an environment in $(VENV)"
	$(PYTHON) -m venv $(VENV)
	-$(BIN)/python -m $(NEW_PIP)

# What the demo needs; everything else needs more, and is installed at once, because every installation compiles the kernels.
$(DEMO_STAMP): pyproject.toml | $(BIN)/python
	@echo "installing optdock with CasADi, SciPy, ruckig and matplotlib: a minute or two"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[plot]'
	touch $(DEMO_STAMP)

$(STAMP): pyproject.toml | $(BIN)/python
	@echo "installing optdock and the developers' tools: a few minutes"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,docs,plot]'
	touch $(DEMO_STAMP) $(STAMP)

demo: $(DEMO_STAMP)
	$(BIN)/optdock demo --out demo
	@echo
	@echo "The program is $(BIN)/optdock; 'source $(BIN)/activate' makes it plain optdock."

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/codespell
	@# The stubs of the NumPy that Python 3.10 has (2.2) know shapes less exactly than those that the types are written for.
	if $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then $(BIN)/mypy; \
	else echo "types are not checked here: mypy needs the stubs of NumPy >= 2.3, and so Python >= 3.11"; fi
	$(BIN)/lint-imports

kernels: $(STAMP)
	$(BIN)/python -m optdock.build_kernels

$(LIBRARY): $(shell find optdock smoothers -name '*.c') optdock/build_kernels.py | $(STAMP)
	$(BIN)/python -m optdock.build_kernels

# An audit runs both lanes, C and NumPy, in every call of a kernel.
test-kernels: $(LIBRARY)
	$(BIN)/python .ci/sanitized_kernels.py
	OPTDOCK_KERNELS=audit $(BIN)/python -m pytest -q $(AUDITED)
	OPTDOCK_KERNELS=twin $(BIN)/python -m pytest -q tests/optdock/test_portfolio.py

# The kernels compiled for aarch64 and run by an emulator of that processor.
test-aarch64: kernels
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'ziglang>=0.13' 'unicorn>=2.1' pyelftools
	$(BIN)/python .ci/aarch64_kernels.py $(ARGS)

unit: $(STAMP)
	$(MAKE) $(LIBRARY) || echo "no kernels in C: the tests run with NumPy alone"
	$(BIN)/python -m pytest -q -n 2 --dist worksteal tests $(UNIT_LEFT_OUT:%=--ignore=tests/%)
	$(BIN)/python -m pytest -q --doctest-modules $$(grep -rl '>>> ' --include='*.py' optdock smoothers checkers)

test: check unit

test-experiments: $(STAMP)
	$(BIN)/python -m pytest -q -n 2 tests/experiments

docs: $(STAMP)
	$(BIN)/python -m pytest -q -n 2 tests/docs
	$(MAKE) site

site: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "open site/index.html"

ui-env: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check playwright

test-ui: ui-env
	@# A browser works in real time, as robots do. Without Chromium the tests are skipped, and pytest ends with 5, no tests.
	$(BIN)/python .ci/retry.py --most 2 -- -q -rs tests/browser $(ARGS) || [ $$? -eq 5 ]

report-check: ui-env
	$(BIN)/python docs/tools/browser_check.py $(ARGS)

figures: $(STAMP)
	$(BIN)/python docs/tools/measured.py $(ARGS)

fuzz: $(STAMP)
	$(BIN)/python -m experiments.fuzz --seconds $(SECONDS) --seed $(SEED) --jobs $(JOBS)

bench: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[bench]'
	$(BIN)/python -m experiments.benchmarks

bench-manoeuvres: $(STAMP)
	$(BIN)/python -m experiments.manoeuvres $(ARGS)

bench-docking: $(STAMP)
	$(BIN)/python -m experiments.docking $(ARGS)

# rclpy lives in an environment of its own: its wheels start every Python of theirs anew, with other library paths.
# The stamp's name is the content of what it was made from, so that a checkout, which touches files, makes nothing anew.
$(ROS_STAMP):
	@echo "making an environment in $(ROS_VENV)"
	@rm -rf $(ROS_VENV)
	@$(PYTHON) -m venv $(ROS_VENV)
	-@$(ROS_BIN)/python -m $(NEW_PIP)
	@echo "installing optdock and rclpy of $(ROS_DISTRO) from PyPI: 250 MB of wheels, a minute or two"
	@$(ROS_BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[bag,plot]' -r $(ROS_WHEELS) || { echo "make: \
	no environment for the ROS package: the wheels of $(ROS_WHEELS) exist for x86-64 Linux and Python 3.10 to 3.13" >&2; exit 1; }
	@# Environments that are made at the same time build in the same folder.
	@flock ros/optdock_ros/setup.py $(ROS_BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e ros/optdock_ros
	@touch $(ROS_STAMP)

ros-env: $(ROS_STAMP)
	@echo "compiling nav2_msgs, tf2_msgs and bond with cc and c++ unless they are up to date: 15 s"
	@$(ROS_BIN)/python ros/interfaces/build.py

ros-demo: ros-env
	@$(ROS_BIN)/python ros/tests/ros_demo.py $(ARGS)

# The types are those of the newer NumPy and rclpy.
ros-types: ros-env
	$(if $(ROS_SUFFIX),,$(ROS_BIN)/mypy --config-file ros/mypy.ini)

# Robots drive in real time: what failed beside other tests, five of them at most, must pass alone. The files are begun
# by name, because the longest ones would come last by their numbers of tests: the demo has two, and takes a minute.
test-ros: ros-types
	$(ROS_BIN)/python .ci/retry.py --beside "-n $(ROS_WORKERS) --dist loadfile --no-loadscope-reorder" -- -q -c ros/tests/pytest.ini \
		$(ROS_LEFT_OUT:%=--ignore=ros/tests/%.py) ros/tests

bench-ros: ros-env
	for bench in $(BENCHES); do $(ROS_BIN)/python ros/tests/bench_$$bench.py $(ARGS) || exit 1; done

experiments: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[ompl]' || echo "the studies run without OMPL"
	failed=0; for script in experiments/[0-9]*.py; do \
	$(BIN)/python $$script --scale $(SCALE) --jobs $(JOBS) || failed=1; done; \
	$(if $(filter-out 1,$(SCALE))$(OPTDOCK_DATA),,$(BIN)/python docs/tools/measured.py experiments/0 --results results || failed=1;) exit $$failed

clean:
	rm -rf $(VENV) .venv-ros .venv-ros-* demo ros-demo results site
