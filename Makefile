# make                               a virtual environment, the Verilog, and a demo recording tracked by it
# make RECORDING=rec.h5 ROI=100,30   the same with your recording; more options in TRACK="--batches 20 …"
# make EXTRAS=all                    the same with all that is optional: torch, plotly, Dask … (default: what --report needs)
# make docs                          the documentation as a site, build/site/index.html
# make release                       wheel, sdist, Verilog of all presets, hashes: build/release
# make test                          what the tests need, and all tests that are not long: minutes
# make test-all                      the same, then the long ones

PYTHON ?= python3
VENV ?= .venv
OUT ?= build
RECORDING ?=
ROI ?=
TRACK ?=
EXTRAS ?= report

# Any text may stand in these: neither make nor the shell reads more into it. Recipes take them from the environment.
override OUT := $(value OUT)
override RECORDING := $(value RECORDING)
override ROI := $(value ROI)
export OUT RECORDING ROI

# A file for each choice of extras: another one is installed when it is asked for.
INSTALLED = $(VENV)/installed-$(EXTRAS)
PIP = $(VENV)/bin/pip --disable-pip-version-check
RUN = $(VENV)/bin/python -m

.PHONY: demo docs release test test-all clean
.DELETE_ON_ERROR:

demo: $(INSTALLED)
	$(RUN) cmfpga build "--out=$$OUT"
	$(RUN) cmfpga track $${ROI:+"--roi=$$ROI"} $(TRACK) "--out=$$OUT/track" $${RECORDING:+-- "$$RECORDING"}
	@printf 'The picture is %s\n' "$$OUT/track/track.png"

test: $(VENV)/installed-for-tests
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) pytest -n 2 --dist worksteal -m 'not long'

test-all: test
	$(RUN) pytest -n 2 --dist worksteal -m long

docs: $(INSTALLED)
	$(PIP) install --quiet -c constraints.txt -e '.[docs]'
	@mkdir -p -- "$$OUT/site"
	$(RUN) mkdocs build --quiet --strict --site-dir "$$(cd -- "$$OUT/site" >/dev/null && pwd)"
	@printf 'The site is %s\n' "$$OUT/site/index.html"

release: $(INSTALLED)
	$(PIP) install --quiet -c constraints.txt -e '.[release]'
	$(VENV)/bin/python docs/release.py "$$OUT/release"

clean:
	rm -rf -- $(VENV) "$$OUT"

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=…")'
	$(PYTHON) -m venv $(VENV)

$(INSTALLED): pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) install --quiet -c constraints.txt -e '.[$(EXTRAS)]'
	@touch $@

$(VENV)/installed-for-tests: $(INSTALLED)
	$(PIP) install --quiet -c constraints.txt -e '.[test]'
	$(PIP) install --quiet --no-deps -r tests/driver/pynq.txt || echo "PYNQ cannot be installed: its tests are skipped"
	@touch $@
