# Every target sets up what it needs, skips what is done and goes on where a stopped run was.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup reproduce-bfm reproduce-flame reproduce-celeba ablation audit report bench stream seeds pretrained lifting pictures openhead surface footprint test nightly lint clean

PYTHON ?= python3
VENV ?= .venv
MODEL ?= openhead
DATA ?=
PRESET ?= paper
SEED ?= 0
SEEDS ?=
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

ifeq ($(filter yes paper no,$(MOBILEFACE)),)
$(error MOBILEFACE must be yes, paper or no. Received $(MOBILEFACE))
endif
ifeq ($(filter yes no,$(MEDIAPIPE)),)
$(error MEDIAPIPE must be yes or no. Received $(MEDIAPIPE))
endif

PY := $(VENV)/bin/python
READY := $(VENV)/.ready
# RINGNET is the prefix of the licensed checkpoint, yes to train ours, or no.
RUN := --model $(MODEL) --data '$(DATA)' --preset $(PRESET) --seed $(SEED) \
       --protocol $(PROTOCOL) --authors '$(AUTHORS)' --evaluator $(EVALUATOR) --jobs $(JOBS) \
       --coma '$(COMA)' --casia '$(CASIA)' --casia-index '$(CASIA_INDEX)' \
       --celeba '$(CELEBA)' --tf-flame '$(TF_FLAME)' --ringnet '$(filter-out yes no,$(RINGNET))' \
       $(if $(FACES),--faces $(FACES)) \
       $(if $(SEEDS),--seeds $(SEEDS)) $(if $(filter paper,$(MOBILEFACE)),--mobileface paper) \
       $(foreach switch,MOBILEFACE MEDIAPIPE RINGNET,$(if $(filter no,$($(switch))),--without $(switch)))
# No start-up notices, and what is compiled is the same whatever the processor offers beyond AVX2.
export TF_CPP_MIN_LOG_LEVEL := 3
export TF_ENABLE_ONEDNN_OPTS := 0
export XLA_FLAGS := --xla_cpu_max_isa=AVX2 $(XLA_FLAGS)

help: ## what there is (this text)
	@echo 'make TARGET [MODEL=openhead|ict|bfm2009|bfm2017|bfm2019] [DATA=path] [PRESET=paper|smoke]'
	@echo '            [SEED=0] [PROTOCOL=paper|released|posed] [AUTHORS=dir] [JOBS=-1] [PYTHON=python3]'
	@echo '     stream: [FACES=1000000]'
	@echo '     on a cluster: [JOBLIB_BACKEND=dask DASK_ADDRESS=tcp://host:port]'
	@echo '     reproduce-bfm: [EVALUATOR=paper|released] [MOBILEFACE=yes|paper|no]'
	@echo '                    [SEEDS=10]'
	@echo '     reproduce-celeba: [CELEBA=dir] [TF_FLAME=dir] [MOBILEFACE=yes|no] [RINGNET=yes|no]'
	@echo '     reproduce-flame: [MODEL=flame] [COMA=dir] [CASIA=dir] [CASIA_INDEX=csv]'
	@echo '                      [MEDIAPIPE=yes|no] [RINGNET=yes|no|prefix of the licensed checkpoint]'
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(READY) ## make the virtual environment in .venv
$(READY): setup.cfg constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 10) <= v <= (3, 13) else \
	  "Python 3.10 to 3.13 is needed; $(PYTHON) is %d.%d. Name another: make PYTHON=python3.12" % v)'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[keras,experiments,fast,dlib,video,heic,onnx,cluster,test]'
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: eos-py \
	  || echo 'eos-py has no wheel here: the one test that compares with it will skip.'
# Alone: FaceMesh loads none of what MediaPipe asks for, half a gigabyte that excludes NumPy 2.
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: --no-deps mediapipe \
	  || echo 'MediaPipe 0.10.21 has no wheel here (it has for Python 3.10 to 3.12 on x86-64 and' \
	  'macOS): photos are read by dlib, and make reproduce-flame needs MEDIAPIPE=no.'
	@touch $@

# What each is made of, and in which order, is in experiments/stages.py.
reproduce-bfm: ## the paper's BFM table, ours beside it   (28 min; 10 with MOBILEFACE=no)
reproduce-flame: ## the paper's CASIA-3D table, ours beside it   (21 min; 10 with RINGNET=no)
reproduce-celeba: ## the paper's CelebA table, ours beside it   (6 min after reproduce-bfm)
ablation: ## the method with a part changed, over five seeds   (40 min after reproduce-bfm)
audit: ## which claims of the paper hold: results/audit/   (3 min after ablation)
bench: ## speed and memory beside the released way: results/bench/   (20 to 40 min)
stream: ## the method on a million faces, in bounded memory   (15 min)
seeds: ## ten seeds of Deep-MDS, and one rounded otherwise   (50 min)
pretrained: ## train the weights that ship with the package, and measure them
lifting: ## the lifting network against the limit, on hard views: results/<model>/lifting/   (40 min)
reproduce-bfm reproduce-flame reproduce-celeba ablation audit bench stream seeds pretrained lifting: | $(READY)
	@$(PY) -m experiments make $@ $(RUN)

report: | $(READY) ## all results of the model on one page: results/<model>/report/index.html
	@$(PY) -m experiments report --model $(MODEL) --preset $(PRESET)

pictures: | $(READY) ## the pictures of docs/, anew from the head model   (20 s)
	@$(PY) -m experiments pictures

openhead: | $(READY) ## rebuild the embedded head model from its source    (downloads a wheel)
	$(PY) -m data_gen.build_openhead

surface: | $(READY) ## the head of `deepmds predict --mesh`, and how far it lies off   [DATA=ICT-FaceKit]
	@$(PY) -m experiments surface --data '$(DATA)'

footprint: | $(READY) ## size, memory and time of an installation: results/bench/footprint.csv   (2 min)
	@$(PY) -m experiments footprint

# Two at a time: a stage keeps about a core busy.
test: | $(READY) ## the tests, but for what takes long                (5 min)
	$(PY) -m pytest -n 3 --dist loadfile --no-loadscope-reorder -m 'not slow'

nightly: | $(READY) ## all tests: kills, full disks, damaged files, clusters   (1.5 h)
	KILLS=30 FUZZ=10 $(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: | $(READY) ## ruff
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .

clean: ## delete arrays and weights; results stay
	rm -rf build .pytest_cache .ruff_cache
