# Every target sets up what it needs, skips what is done and goes on where a stopped run was.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup setup-mediapipe reproduce-bfm reproduce-flame reproduce-celeba ablation audit report bench stream seeds pretrained pictures openhead test nightly lint clean

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
COMA ?=
CASIA ?=
CASIA_INDEX ?=
CELEBA ?=
TF_FLAME ?=
RINGNET ?= yes
MEDIAPIPE ?= yes
JOBS ?= -1
FACES ?=
# Of a cluster that does the work on faces and images, see experiments/tasks.py.
JOBLIB_BACKEND ?=
DASK_ADDRESS ?=
RAY_ADDRESS ?=
export JOBLIB_BACKEND DASK_ADDRESS RAY_ADDRESS

ifeq ($(filter yes no,$(MOBILEFACE)),)
$(error MOBILEFACE must be yes or no. Received $(MOBILEFACE))
endif
ifeq ($(filter yes no,$(MEDIAPIPE)),)
$(error MEDIAPIPE must be yes or no. Received $(MEDIAPIPE))
endif

PY := $(VENV)/bin/python
READY := $(VENV)/.ready
MEDIAPIPE_VENV ?= .venv-mediapipe
MEDIAPIPE_READY := $(MEDIAPIPE_VENV)/.ready
# One folder for everything that would change its arrays; experiments/run.py names it the same.
SIZES := $(PRESET)-$(PROTOCOL)-seed$(SEED)
BUILD := build/$(MODEL)/bfm-$(SIZES)
FLAME := build/$(MODEL)/flame-$(SIZES)$(if $(COMA),-coma)$(if $(CASIA),-casia)
# CelebA is where it is said to be, or in DATA=.
CELEBA_DIR := $(or $(CELEBA),$(patsubst %/img_align_celeba,%,$(firstword \
  $(if $(DATA),$(wildcard $(DATA)/img_align_celeba $(DATA)/*/img_align_celeba)))))
PHOTOS := build/$(MODEL)/celeba-$(SIZES)$(if $(CELEBA_DIR),-real)
RUN := --model $(MODEL) --data '$(DATA)' --preset $(PRESET) --seed $(SEED) \
       --protocol $(PROTOCOL) --authors '$(AUTHORS)' --evaluator $(EVALUATOR) --jobs $(JOBS)
# RINGNET is the prefix of the licensed checkpoint, yes to train ours, or no.
RINGNET_FILE := $(filter-out yes no,$(RINGNET))
FLAME_FILES := --coma '$(COMA)' --casia '$(CASIA)' --casia-index '$(CASIA_INDEX)' \
               --ringnet '$(RINGNET_FILE)' --mediapipe $(MEDIAPIPE_VENV)/bin/python
RUN_FLAME := $(RUN) --track flame $(FLAME_FILES)
RUN_CELEBA := $(RUN) --track celeba $(FLAME_FILES) --celeba '$(CELEBA_DIR)' --tf-flame '$(TF_FLAME)'
# The table is another one by the authors' evaluator, of the same predictions.
TABLE := $(BUILD)/bfm$(if $(filter released,$(EVALUATOR)),-evaluator-released).json
# No start-up notices, and sums in one order whatever the processor offers.
export TF_CPP_MIN_LOG_LEVEL := 3
export TF_ENABLE_ONEDNN_OPTS := 0
STAGE := $(PY) -m experiments

help: ## what there is (this text)
	@echo 'make TARGET [MODEL=openhead|ict|bfm2009|bfm2017|bfm2019] [DATA=path] [PRESET=paper|smoke]'
	@echo '            [SEED=0] [PROTOCOL=paper|released] [AUTHORS=dir] [JOBS=-1] [PYTHON=python3]'
	@echo '     stream: [FACES=1000000]'
	@echo '     on a cluster: [JOBLIB_BACKEND=dask DASK_ADDRESS=tcp://host:port]'
	@echo '     reproduce-bfm: [EVALUATOR=paper|released] [MOBILEFACE=yes|no]'
	@echo '     reproduce-celeba: [CELEBA=dir] [TF_FLAME=dir] [MOBILEFACE=yes|no] [RINGNET=yes|no]'
	@echo '     reproduce-flame: [MODEL=flame] [COMA=dir] [CASIA=dir] [CASIA_INDEX=csv]'
	@echo '                      [MEDIAPIPE=yes|no] [RINGNET=yes|no|prefix of the licensed checkpoint]'
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(READY) ## make the virtual environment in .venv
$(READY): setup.cfg constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 10) <= v <= (3, 13) else \
	  "Python 3.10 to 3.13 is needed; $(PYTHON) is %d.%d. Name another: make PYTHON=python3.12" % v)'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[experiments,fast,images,cluster,test]'
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: eos-py \
	  || echo 'eos-py has no wheel here: the one test that compares with it will skip.'
	@touch $@

setup-mediapipe: $(MEDIAPIPE_READY) ## make the one of MediaPipe in .venv-mediapipe
# It excludes what TensorFlow needs (numpy 2, protobuf 5), and has no wheel for Python 3.13.
$(MEDIAPIPE_READY): constraints-mediapipe.txt
	@for python in $(PYTHON) python3.12 python3.11 python3.10; do \
	  $$python -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 12))' 2> /dev/null \
	    && exec $$python -m venv $(MEDIAPIPE_VENV); \
	done; echo 'MediaPipe 0.10.21 needs Python 3.10 to 3.12. Name one: make PYTHON=python3.12,' \
	  'or go without: make MEDIAPIPE=no' >&2; exit 1
	$(MEDIAPIPE_VENV)/bin/python -m pip install -q --disable-pip-version-check --no-deps \
	  --only-binary=:all: -r constraints-mediapipe.txt
	@touch $@

reproduce-bfm: $(TABLE) ## the paper's BFM table, ours beside it   (70 min; 15 with MOBILEFACE=no)
	@$(STAGE) show $(RUN)

$(BUILD)/faces.json: | $(READY)
	@$(STAGE) faces $(RUN)
$(BUILD)/networks.json: $(BUILD)/faces.json
	@$(STAGE) networks $(RUN)
$(BUILD)/predictions.json: $(BUILD)/networks.json
	@$(STAGE) predictions $(RUN)
$(BUILD)/images.json: $(BUILD)/faces.json
	@$(STAGE) images $(RUN)
# Convolutions are oneDNN's here: a step takes three quarters of the time.
$(BUILD)/mobileface.json: $(BUILD)/images.json
	@TF_ENABLE_ONEDNN_OPTS=1 $(STAGE) mobileface $(RUN)
$(TABLE): $(BUILD)/predictions.json $(if $(filter-out no,$(MOBILEFACE)),$(BUILD)/mobileface.json)
	@$(STAGE) bfm $(RUN)

reproduce-flame: $(FLAME)/flame.json ## the paper's CASIA-3D table, ours beside it   (45 min; 10 with RINGNET=no)
	@$(STAGE) show $(RUN_FLAME)

$(FLAME)/frames.json: | $(READY)
	@$(STAGE) frames $(RUN_FLAME)
$(FLAME)/scans.json: $(CASIA_INDEX) | $(READY)
	@$(STAGE) scans $(RUN_FLAME)
$(FLAME)/networks.json: $(FLAME)/frames.json
	@$(STAGE) networks $(RUN_FLAME)
$(FLAME)/predictions.json: $(FLAME)/networks.json $(FLAME)/scans.json
	@$(STAGE) predictions $(RUN_FLAME)
$(FLAME)/mediapipe.json: $(FLAME)/scans.json | $(MEDIAPIPE_READY)
	@$(STAGE) mediapipe $(RUN_FLAME)
$(FLAME)/rings.json: | $(READY)
	@$(STAGE) rings $(RUN_FLAME)
$(FLAME)/ringnet.json: $(FLAME)/rings.json $(FLAME)/scans.json
	@TF_ENABLE_ONEDNN_OPTS=1 $(STAGE) ringnet $(RUN_FLAME)
$(FLAME)/ringnet-licensed.json: $(FLAME)/scans.json
	@$(STAGE) ringnet $(RUN_FLAME)
$(FLAME)/flame.json: $(FLAME)/predictions.json \
    $(if $(filter-out no,$(MEDIAPIPE)),$(FLAME)/mediapipe.json) \
    $(if $(filter-out no,$(RINGNET)),$(FLAME)/ringnet$(if $(RINGNET_FILE),-licensed).json)
	@$(STAGE) flame $(RUN_FLAME)

reproduce-celeba: $(PHOTOS)/celeba.json $(if $(TF_FLAME),$(PHOTOS)/celeba-flame.json) ## the paper's CelebA table, ours beside it   (10 min after reproduce-bfm)
	@$(STAGE) show $(RUN_CELEBA)

$(PHOTOS)/photos.json: | $(READY)
	@$(STAGE) photos $(RUN_CELEBA)
$(PHOTOS)/predictions.json: $(PHOTOS)/photos.json $(BUILD)/networks.json
	@$(STAGE) predictions $(RUN_CELEBA)
$(PHOTOS)/mobileface.json: $(PHOTOS)/photos.json $(BUILD)/mobileface.json
	@TF_ENABLE_ONEDNN_OPTS=1 $(STAGE) mobileface $(RUN_CELEBA)
$(PHOTOS)/celeba.json: $(PHOTOS)/predictions.json \
    $(if $(filter-out no,$(MOBILEFACE)),$(PHOTOS)/mobileface.json)
	@$(STAGE) celeba $(RUN_CELEBA)
$(PHOTOS)/celeba-flame.json: $(FLAME)/networks.json \
    $(if $(filter-out no,$(RINGNET)),$(FLAME)/ringnet$(if $(RINGNET_FILE),-licensed).json) \
    $(if $(filter-out no,$(MEDIAPIPE)),| $(MEDIAPIPE_READY))
	@$(STAGE) celeba_flame $(RUN_CELEBA)

ablation: $(BUILD)/networks.json ## the method with a part changed, over five seeds   (25 min after reproduce-bfm)
	@$(STAGE) ablation $(RUN)

$(BUILD)/ablation.json: $(BUILD)/networks.json
	@$(STAGE) ablation $(RUN)

# Always run: it reads the tables of whatever other targets were run.
audit: $(TABLE) $(BUILD)/ablation.json ## which claims of the paper hold: results/audit/   (3 min after ablation)
	@$(STAGE) audit $(RUN) $(FLAME_FILES) --celeba '$(CELEBA_DIR)'

report: | $(READY) ## all results of the model on one page: results/<model>/report/index.html
	@$(STAGE) report --model $(MODEL) --preset $(PRESET)

ifneq ($(AUTHORS),)
$(PHOTOS)/celeba.json: $(PHOTOS)/predictions/authors_weights.npz
$(PHOTOS)/predictions/authors_weights.npz: | $(PHOTOS)/predictions.json
	@$(STAGE) predictions $(RUN_CELEBA)
$(FLAME)/flame.json: $(FLAME)/predictions/authors_weights.npz
$(FLAME)/predictions/authors_weights.npz: | $(FLAME)/predictions.json
	@$(STAGE) predictions $(RUN_FLAME)
$(TABLE): $(BUILD)/predictions/authors_weights.npz
$(BUILD)/predictions/authors_weights.npz: | $(BUILD)/predictions.json
	@$(STAGE) predictions $(RUN)
endif

bench: | $(READY) ## speed and memory beside the released way: results/bench/   (18 min)
	@$(STAGE) bench $(RUN)

stream: $(BUILD)/networks.json ## the method on a million faces, in bounded memory   (20 min after reproduce-bfm)
	@$(STAGE) stream $(RUN) $(if $(FACES),--faces $(FACES))

seeds: | $(READY) ## five seeds of ours and ours_stable, their spread    (45 min)
	@$(STAGE) seeds $(RUN)

pretrained: | $(READY) ## train the weights that ship with the package, and measure them
	@$(STAGE) pretrained $(RUN)

pictures: | $(READY) ## the pictures of docs/, anew from the head model   (20 s)
	@$(STAGE) pictures

openhead: | $(READY) ## rebuild the embedded head model from its source    (downloads a wheel)
	$(PY) -m data_gen.build_openhead

# Two at a time: a stage keeps about a core busy.
PYTEST = MEDIAPIPE_PYTHON=$(abspath $(MEDIAPIPE_VENV))/bin/python $(PY) -m pytest

test: | $(READY) ## the tests, but for what takes long                (5 min)
	@$(MAKE) --no-print-directory setup-mediapipe || echo 'The tests of MediaPipe will skip.'
	$(PYTEST) -n 2 --dist loadfile -m 'not slow'

nightly: | $(READY) ## all tests: kills, full disks, damaged files, clusters   (1 h)
	@$(MAKE) --no-print-directory setup-mediapipe || echo 'The tests of MediaPipe will skip.'
	KILLS=40 FUZZ=10 $(PYTEST)

lint: | $(READY) ## ruff
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .

clean: ## delete arrays and weights; results stay
	rm -rf build .pytest_cache .ruff_cache
