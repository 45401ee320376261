# The one task runner. `make help` prints the lines that begin with #: and the texts behind ##.
#:
#: Variables, given behind `make`; a comma list makes every combination (make sweep ENV=cartpole ERR=0,0.1):
#:   ENV       the task: cartpole, pendulum, lunarlander, mountaincar, module:NAME, gym:ID or brax:NAME
#:   ERR       chance that an advice has the wrong sign (0)
#:   ALGO      gpc, gpc-ns, coach or module:NAME (the three built-in ones; for a grid gpc)
#:   TEACHER   who teaches (oracle): Alg. 4 of the thesis, module:NAME or replay:FILE
#:   SEEDS     n, for seeds 0 to n-1 (100), or which: 100-199 or 3,7
#:   EPISODES  of each run (30, 40 for pendulum, 200 for lunarlander)
#:   ORACLE    whose actions the teacher aims at (gpc, heuristic for lunarlander, pump for mountaincar): an expert
#:             of the task, the folder of a saved policy, or module:function
#:   DELTA     the teacher is silent this near to its target (0.05)
#:   RATE      chance of advice at a step (0.05)
#:   LP, LH    length-scales of the policy and of the human model (those of the thesis)
#:   SET       a setting of a learner or teacher of one's own: SET=NAME=1,2
#:   OUT       run folder (runs/ENV-HASH)
#:   JOBS      processes at once (one for each core)
#:   ENGINE    what runs them: processes of this machine, or ray (processes)
#:   ADDRESS   of the Ray cluster: auto or HOST:PORT (a Ray that is started here)
#:   SHARD     i/n, the i-th of n shares alone, for gpcjax merge (all)
#:   KEEP      policies or states of each run, for Python, and to go on from (nothing)
#:   START     runs begin with what was learned there: a run folder with kept states, a saved learner (with nothing)
#:   CREDIT    seconds between a step and the advice about it, as the learner reckons
#:   SPEC      a TOML file with such settings, sweeps/*.toml for one
#:   QUICK     1 for a small reproduction
#:   ONLY      parts of it: illustrations, pendulum, cartpole, active, oracles, lander (all)
#:   ARGS      any other flags, as one word: ARGS='--beta 10,30 --no-sparsify'; also for test, test-all, bench, dist, lock; for
#:             compare the folders
#:   PYTHON    what .venv is made with (python3)
#:

PYTHON = python3
OUT =
SPEC =
QUICK =
ONLY =
ARGS =
READY := .venv/.ready
PIP := .venv/bin/python -m pip --quiet --quiet --disable-pip-version-check
GPCJAX := .venv/bin/python -m gpcjax

# Which variables a target takes. Any other is refused here, before anything is set up: EVN= must not pass silently.
FLAGS := ENV:env ERR:error ALGO:algo SEEDS:seeds EPISODES:episodes TEACHER:teacher ORACLE:oracle DELTA:delta \
	RATE:rate SET:set LP:policy-length-scale LH:human-length-scale CREDIT:credit KEEP:keep START:start OUT:out JOBS:jobs \
	ENGINE:engine ADDRESS:address SHARD:shard
name = $(firstword $(subst :, ,$1))
TAKES_sweep := $(foreach pair,$(FLAGS),$(call name,$(pair))) SPEC ARGS
TAKES_grid := $(TAKES_sweep)
TAKES_tune := $(filter-out KEEP ENGINE ADDRESS SHARD,$(TAKES_sweep))
TAKES_report := OUT
TAKES_compare := OUT ARGS
TAKES_oracles := ENV
TAKES_reproduce := QUICK ONLY OUT JOBS
TAKES_publish := OUT JOBS
TAKES_teach := ENV ALGO ORACLE LP LH CREDIT OUT ARGS
TAKES_study := SPEC OUT ARGS
TAKES_bench := ARGS
TAKES_bench-teach := ARGS
TAKES_test := ARGS
TAKES_test-all := ARGS
TAKES_torture := ARGS
TAKES_dist := ARGS
TAKES_lock := ARGS
GOALS := $(or $(MAKECMDGOALS),help)
TAKEN := $(foreach goal,$(GOALS),$(TAKES_$(goal))) PYTHON
GIVEN := $(foreach variable,$(.VARIABLES),$(if $(filter command,$(origin $(variable))),$(variable)))
REFUSED := $(firstword $(filter-out $(TAKEN),$(GIVEN)))
$(if $(REFUSED),$(error '$(REFUSED)' is no variable of make $(GOALS): give $(strip $(TAKEN))))

# A value is a value: make expands those of the command line when it hands them to a program's environment, and runs what
# $(shell) in them says. So each is set to its own text, once and for all, and handed to nobody.
OURS := $(sort $(GIVEN) $(foreach target,sweep reproduce teach test,$(TAKES_$(target))) PYTHON)
$(foreach variable,$(OURS),$(if $(filter command environment%,$(origin $(variable))),$(eval override $(variable) := $$(value $(variable)))))
unexport $(OURS)
MAKEOVERRIDES :=

# A value given on the command line becomes a flag: one word for the shell, whatever is in it. ARGS becomes several, by
# the quotes in it, and nothing else of it means anything to the shell.
define newline


endef
quoted = '$(subst $(newline), ,$(subst ','\'',$(value $1)))'
flag = $(if $(filter $(call name,$1),$(GIVEN)),--$(lastword $(subst :, ,$1))=$(call quoted,$(call name,$1)))
WORDS = words=$$(printf %s $(call quoted,ARGS) | xargs printf '%s\n') || exit 2; IFS=$$(printf '\n_') && IFS=$${IFS%_}; set -f;
# Where there are such words only what is run says itself: the line that takes them apart is for nobody to read.
with_args = $(if $(ARGS),@$(WORDS) $1 $$words,$1)
SETTINGS = $(if $(SPEC),$(call quoted,SPEC)) $(foreach pair,$(FLAGS),$(call flag,$(pair)))
REPRODUCTION = $(if $(filter-out 0,$(QUICK)),--quick) $(foreach pair,ONLY:only OUT:out JOBS:jobs,$(call flag,$(pair)))

# A switch is on or off: what else somebody writes may have been meant either way.
NO_SWITCH = $(filter-out 0 1,$(QUICK))$(word 2,$(QUICK))
$(if $(and $(filter reproduce,$(GOALS)),$(NO_SWITCH)),$(error QUICK=$(call quoted,QUICK): give 1, or nothing for all of it))

.PHONY: help sweep grid tune report compare reproduce publish oracles teach study bench bench-teach test test-all torture
.PHONY: docs dist lint format lock clean
help: ## this list (default)
	@sed -n -e 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile | expand -t 18
	@sed -n -e 's/^#: \{0,1\}//p' Makefile

sweep: $(READY) ## teach every combination, print a table, draw the curves
	$(call with_args,$(GPCJAX) sweep $(SETTINGS))

grid: $(READY) ## the same over lists of hyperparameters, with a heatmap
	$(call with_args,$(GPCJAX) grid $(SETTINGS))

tune: $(READY) ## search hyperparameters, judge the best (ARGS='--search policy-length-scale=0.02:20')
	$(call with_args,$(GPCJAX) tune $(SETTINGS))

report: $(READY) ## draw a run folder's table and figures again (OUT=)
	$(GPCJAX) report $(if $(OUT),-- $(call quoted,OUT))

reproduce: $(READY) ## run every experiment of the thesis and report on its claims
	$(GPCJAX) reproduce $(REPRODUCTION)

compare: $(READY) ## compare run folders, run by run of the same seed (ARGS='A B', OUT=)
	$(call with_args,$(GPCJAX) compare $(call flag,OUT:out))

oracles: $(READY) ## learn the shipped oracles again (ENV=, or each)
	$(GPCJAX) oracles $(call flag,ENV:env)

publish: $(READY) ## reproduce, then make all numbers and pictures of README and docs from it (OUT=)
	$(GPCJAX) reproduce $(REPRODUCTION)
	.venv/bin/python -m docs.publish $(if $(OUT),$(call quoted,OUT))

teach: $(READY) ## teach a policy by hand, in the browser (ENV=, ALGO=; OUT= goes on)
	$(call with_args,$(GPCJAX) teach $(foreach pair,$(FLAGS),$(if $(filter $(call name,$(pair)),$(TAKES_teach)),$(call flag,$(pair)))))

study: $(READY) ## hold a study with people, many at once (SPEC=sweeps/study_thesis.toml; OUT= goes on)
	$(call with_args,$(GPCJAX) study $(if $(SPEC),$(call quoted,SPEC)) $(call flag,OUT:out))

bench: $(READY) ## measure the throughput
	$(call with_args,.venv/bin/python -m benchmarks.throughput)

bench-teach: $(READY) $(BROWSER) ## measure teaching in a real browser
	$(call with_args,.venv/bin/python -m benchmarks.teaching)

# What tests in a browser drive, asked for once. Where it cannot be had they do not run, and say so.
BROWSER := .venv/.browser
APT = test "$$(id -u)" = 0 && timeout 300 apt-get -qq update && timeout 600 apt-get -qq install -y chromium
$(BROWSER): | $(READY)
	@command -v chromium >/dev/null || { $(APT); } >/dev/null 2>&1 || \
		echo 'no Chromium here (Debian: apt install chromium): the tests in a browser do not run' >&2
	@touch $@

test: $(READY) $(BROWSER) ## run one good test of each thing (ARGS='-k NAME')
	$(call with_args,.venv/bin/python -m pytest -n 2)

# What makes the site, beside all else in .venv: setting that up takes no longer for those who read it elsewhere.
DOCS := .venv/.docs
$(DOCS): requirements-docs.lock | $(READY)
	@$(PIP) install --require-hashes --only-binary :all: -r requirements-docs.lock && touch $@

docs: $(READY) $(DOCS) ## build the site into site/ (open site/index.html)
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict

test-all: $(READY) $(BROWSER) $(DOCS) ## run every test: further learners, tasks, sizes, whole pages
	$(call with_args,.venv/bin/python -m pytest -n 2 --all)

torture: $(READY) ## spoil hundreds of run folders, kill hundreds of sweeps, and see that nothing is lost
	$(call with_args,.venv/bin/python -m tests.torture)

dist: $(READY) ## build wheel and sdist, and try them in clean environments (ARGS=--lowest: oldest versions)
	$(call with_args,.venv/bin/python -m tests.dist)

lint: $(READY) ## check style, types and the direction of imports
	.venv/bin/ruff check . && .venv/bin/ruff format --check .
	.venv/bin/basedpyright && .venv/bin/lint-imports --no-logo

format: $(READY) ## write the code in its one style
	.venv/bin/ruff check --fix . && .venv/bin/ruff format .

lock: $(READY) ## write requirements.lock anew (ARGS=--upgrade for newer versions)
	$(call with_args,.venv/bin/uv pip compile --universal --python-version 3.11 --generate-hashes \
		--only-binary :all: --quiet --custom-compile-command 'make lock' --group dev --extra teach --extra tune --extra cluster \
		--extra mujoco --extra onnx pyproject.toml -o requirements.lock)
	$(call with_args,.venv/bin/uv pip compile --universal --python-version 3.11 --generate-hashes \
		--only-binary :all: --quiet --custom-compile-command 'make lock' --group docs --constraint requirements.lock -o requirements-docs.lock)

clean: ## remove .venv, the site and all caches, no results
	rm -rf .venv site .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# Set up once: again only if the lock or pyproject.toml is newer, or .venv has lost its Python. What is wrong with a
# sweep is said before that takes its minutes, as far as it can be told without .venv: not what modules have, and not
# where a .venv is that others may have installed things into.
IS_THERE := $(shell test -x .venv/bin/python && echo yes)
.PHONY: $(if $(IS_THERE),,$(READY))
PYTHON_WORD = $(call quoted,PYTHON)
sweep: CHECK = $(call with_args,$(PYTHON_WORD) -m gpcjax sweep $(SETTINGS) --dry-run)
grid: CHECK = $(call with_args,$(PYTHON_WORD) -m gpcjax grid $(SETTINGS) --dry-run)
tune: CHECK = $(call with_args,$(PYTHON_WORD) -m gpcjax tune $(SETTINGS) --dry-run)
reproduce: CHECK = $(PYTHON_WORD) -m gpcjax reproduce $(REPRODUCTION) --dry-run
NEEDED := gpcjax needs Python 3.11 or newer with venv and pip (Debian: apt install python3-venv; or PYTHON=another)
$(READY): requirements.lock pyproject.toml
	@$(PYTHON_WORD) -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo '$(NEEDED)' >&2; exit 2; }
	@$(if $(IS_THERE),,$(CHECK))
	@echo 'setting up .venv, once: this takes a minute or more'
	@$(PYTHON_WORD) -m venv .venv && $(PIP) install --require-hashes --only-binary :all: -r requirements.lock
	@$(PIP) install --no-deps --no-index --no-build-isolation -e . && touch $@
