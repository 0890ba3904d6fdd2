# Every target sets up what it needs, skips what is done and goes on where a stopped run was.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
# Targets whose steps are in experiments/Snakefile, and those that read what they wrote.
TARGETS := reproduce-bfm reproduce-flame reproduce-celeba ablation audit bench stream seeds \
           pretrained lifting released-weights check report
.PHONY: help setup $(TARGETS) all-results dag docs pictures openhead real-faces surface footprint test nightly lint \
        clean

PYTHON ?= python3
VENV ?= .venv
MODEL ?= openhead
DATA ?=
PRESET ?= full
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
SFM ?=
RINGNET ?= yes
MEDIAPIPE ?= yes
JOBS ?= -1
FACES ?=
REAL ?=
DRY ?=
TARGET ?= reproduce-bfm
# Options of Snakemake, such as those of a cluster, see docs/large.md.
SNAKEMAKE ?=
VARIABLES := MODEL DATA PRESET SEED SEEDS PROTOCOL AUTHORS EVALUATOR MOBILEFACE COMA CASIA \
             CASIA_INDEX CELEBA TF_FLAME SFM RINGNET MEDIAPIPE JOBS FACES DRY SNAKEMAKE

PY := $(VENV)/bin/python
READY := $(VENV)/.ready
VALUES := $(foreach name,$(VARIABLES),'$(name)=$(subst ','\'',$($(name)))')

help: ## this text
	@echo 'make TARGET [MODEL=openhead|ict|bfm2009|bfm2017|bfm2019] [DATA=path] [PRESET=full|smoke]'
	@echo '            [SEED=0] [PROTOCOL=paper|released|posed] [AUTHORS=dir] [JOBS=-1] [PYTHON=python3]'
	@echo '            [DRY=1: say what would be done] [SNAKEMAKE=options, such as those of a cluster]'
	@echo '     dag: [TARGET=reproduce-bfm]   stream: [FACES=1000000]   seeds: [SEEDS=10]'
	@echo '     reproduce-bfm: [EVALUATOR=paper|released] [MOBILEFACE=yes|paper|no]'
	@echo '                    [SEEDS=10]'
	@echo '     reproduce-celeba: [CELEBA=dir] [TF_FLAME=dir] [MOBILEFACE=yes|no] [RINGNET=yes|no]'
	@echo '     all-results: DATA=ICT-FaceKit AUTHORS=dir SFM=dir REAL=npz'
	@echo '     lifting, pretrained: [SFM=eos'\''s folder share, with the Surrey Face Model]'
	@echo '     reproduce-flame: [MODEL=flame] [COMA=dir] [CASIA=dir] [CASIA_INDEX=csv]'
	@echo '                      [MEDIAPIPE=yes|no] [RINGNET=yes|no|prefix of the licensed checkpoint]'
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(READY) ## make the virtual environment in .venv
$(READY): setup.cfg constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else \
	  "Python 3.11 to 3.13 is needed; $(PYTHON) is %d.%d. Name another: make PYTHON=python3.12" % v)'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[experiments,fast,dlib,video,heic,test]'
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: eos-py \
	  || echo 'eos-py has no wheel here: the tests that need it will skip.'
# Alone: FaceMesh loads none of what MediaPipe asks for, half a gigabyte that excludes NumPy 2.
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: --no-deps mediapipe \
	  || echo 'MediaPipe 0.10.21 has no wheel here (it has for Python 3.11 and 3.12 on x86-64 and' \
	  'macOS): photos are read by dlib, and make reproduce-flame needs MEDIAPIPE=no.'
	@touch $@

# What each is made of, and in which order, is in experiments/Snakefile.
reproduce-bfm: ## the paper's BFM table next to ours   (28 min; 10 with MOBILEFACE=no)
reproduce-flame: ## the paper's CASIA-3D table next to ours   (21 min; 10 with RINGNET=no)
reproduce-celeba: ## the paper's CelebA table next to ours   (6 min after reproduce-bfm)
ablation: ## the method with one part changed, over five seeds   (1 h after reproduce-bfm)
audit: ## which claims of the paper are supported: results/audit/   (3 min after ablation)
bench: ## speed against the authors' implementation: results/bench/   (4 min)
stream: ## the method on a million faces, in bounded memory   (15 min)
seeds: ## ten seeds of Deep-MDS   (1 h)
pretrained: ## train the weights that ship with the package, and measure them
lifting: ## the lifting network against the lower bound, on hard views: results/<model>/lifting/   (2.5 h)
released-weights: ## the released weights around the BFM's mean: results/released-weights/   [AUTHORS=dir]   (45 min)
check: ## compare results/<model>/bfm/table.csv with the committed one
report: ## all results of the model on one page: results/<model>/report/report.md
$(TARGETS): | $(READY)
	@$(PY) -m experiments.make $@ $(VALUES)

# What is done is skipped, so the same command goes on after a stop.
GIVEN := AUTHORS=$(AUTHORS) SFM=$(SFM)
all-results: | $(READY) ## all of results/, on both open models   (12 h)
	@for given in 'DATA=$(DATA)' 'AUTHORS=$(AUTHORS)' 'SFM=$(SFM)' 'REAL=$(REAL)'; do \
	  [[ -e "$${given#*=}" && "$$given" != *' '* ]] || { \
	    echo "error: $${given%%=*} must be a file or folder without a space in its path, see" \
	      "docs/commands.md. Received '$${given#*=}'." >&2; exit 2; }; \
	done
	@for model in 'MODEL=openhead' 'MODEL=ict DATA=$(DATA) RINGNET=no'; do \
	  for target in 'reproduce-bfm SEEDS=10' 'reproduce-bfm SEEDS=10 EVALUATOR=released' \
	      'reproduce-bfm PROTOCOL=posed MOBILEFACE=no' reproduce-flame reproduce-celeba ablation \
	      'seeds SEEDS=10' 'audit SEEDS=10' 'lifting DATA=$(DATA)'; do \
	    $(MAKE) --no-print-directory DATA= $$model $(GIVEN) $$target; \
	  done; \
	done; \
	for target in pretrained 'real-faces REAL=$(REAL)' surface released-weights bench footprint; do \
	  $(MAKE) --no-print-directory DATA=$(DATA) $(GIVEN) $$target; \
	done; \
	for target in stream report 'report MODEL=ict DATA=$(DATA)' docs; do \
	  $(MAKE) --no-print-directory DATA= $$target; \
	done

dag: | $(READY) ## draw the steps of a target, TARGET=reproduce-bfm: build/dag.svg   (needs Graphviz)
	@$(PY) -m experiments.make $(TARGET) DAG=build/dag.svg $(VALUES)

docs: | $(READY) ## README.md and docs/ from their templates and the results   (5 s)
	@$(PY) -m docs.make_docs

pictures: | $(READY) ## the pictures of docs/, from the head model   (20 s)
	@$(PY) -m docs.make_pictures

openhead: | $(READY) ## rebuild the embedded head model from its source    (downloads a wheel)
	$(PY) -m data_gen.build_openhead

real-faces: | $(READY) ## what real photos tell about detectors: results/<model>/real/   [REAL=npz]
	@$(PY) -m experiments pretrained.real_faces '$(REAL)' --data '$(DATA)'

surface: | $(READY) ## the head of `deepmds predict --mesh`, and its errors   [DATA=ICT-FaceKit]
	@$(PY) -m experiments pretrained.surface --data '$(DATA)'

footprint: | $(READY) ## size, memory and time of an installation: results/footprint/   (2 min)
	@$(PY) -m experiments bench.footprint

# Two at a time: a step keeps about a core busy.
test: | $(READY) ## the tests, except slow ones                (3 min)
	$(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'not slow'

nightly: | $(READY) ## all tests, including kills, full disks, damaged files
	KILLS=6 FUZZ=10 $(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: | $(READY) ## ruff, and mypy on the public interface
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy --warn-unused-ignores tests/interface.py

clean: ## delete arrays and weights; results stay
	rm -rf build .snakemake .pytest_cache .ruff_cache
