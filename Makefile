# make demo: from a fresh clone to a Pareto plot.  make test test-apps: every check.  Both create .venv themselves.

PYTHON ?= python3
BIN := .venv/bin
# errors alone are printed
INSTALL := $(BIN)/python -m pip --disable-pip-version-check install -qq -c constraints.txt
RESULTS := results
comma := ,
REPORT := $(RESULTS)/report

include research/rows.mk

BASELINE := rlbench/benchmark/regression/baselines/mini.json

# $(call page,REPORT [OPTIONS],RESULTS,NAME): write a report as the page docs/results/NAME.md
define page
$(BIN)/rlbench report $(1) --results $(2) --out docs/made
mv docs/made/$(firstword $(1)).md docs/results/$(3).md && rm -r docs/made
endef

# $(call regress,PRESET [OPTIONS]): score REGRESSIONS, also by relL2, and write the report of last frames to docs/made/PRESET
define regress
$(BIN)/rlbench run -m '$(REGRESSIONS)' --preset $(1) --spp 1,2,4 --times none --keep-images --out $(RESULTS)/regressions-$(firstword $(1))
$(BIN)/rlbench evaluate $(RESULTS)/regressions-$(firstword $(1)) -m '$(REGRESSIONS)' --preset $(1) --metrics psnr,rel_l2
$(BIN)/rlbench report last-frames -m '$(REGRESSIONS)' --results $(RESULTS)/regressions-$(firstword $(1))/evaluated --out docs/made/$(firstword $(1))
endef

# what the picture of the viewer shows
SHOWN := view=flip&clip=0&frame=7&a=ours&b=mean&split=0.5&px=120&py=90

SPP := 1000
HD := hd
GPU := cuda
QUEUE := campaign

.PHONY: demo docs tables baseline table1 table1-720 viewer unseen speed gpu hd metric-speed overhead takes regressions real large recovery drift gradients stress training campaign contact teaser switched videos site test test-apps test-all lowest format clean

demo: .venv/run.stamp
	$(BIN)/rlbench run --preset mini --keep-images --out $(RESULTS)
	$(BIN)/rlbench report all --results $(RESULTS) --out $(REPORT)
	$(BIN)/rlbench view $(RESULTS) --out $(REPORT)/report.html
	$(BIN)/rlbench decide --sample-ms 26.3 --frame-ms 250 --results $(RESULTS) || test $$? -eq 2
	@echo
	@echo "Pareto plot and tables: $(REPORT)/    images, layers, curves, table, in a browser: $(REPORT)/report.html"

# the summary of every row of every method, extras included, and its figures
docs: .venv/dev.stamp
	$(BIN)/rlbench run --methods 'all/*' --preset mini --spp 0.5,1,2,4 --out $(RESULTS)
	$(BIN)/rlbench report summary --results $(RESULTS) --out docs/made
	$(BIN)/rlbench report pareto --results $(RESULTS) --out docs/made --methods all,oidn/tuned
	$(BIN)/rlbench report winners --results $(RESULTS) --out docs/made
	$(BIN)/rlbench images -m ours,oidn-intel,imcd,ntas,svgf,mean --scenes city --out docs/made
	mv docs/made/city-1spp-07.png docs/made/images.png && rm -r docs/made/city-1spp-07
	cp docs/made/*.md docs/made/*.png docs/made/winners.csv docs/results && rm -r docs/made

# the tables of README and documentation that are made from results, rows and cards
tables: .venv/run.stamp
	$(BIN)/python docs/tables.py

# the baseline that ships: every row on mini, with four orders of the samples; and a small one for the tests
baseline: .venv/dev.stamp
	$(BIN)/rlbench run --methods 'all/*' --preset mini --spp 0.5,1,2,4 --seed 0:4 --times none --out $(RESULTS)/baseline
	$(BIN)/rlbench regress --results $(RESULTS)/baseline --update --baseline $(BASELINE)
	$(BIN)/rlbench run --methods 'all/*' --preset tiny --scenes city --spp 1,4 --times none --out $(RESULTS)/tiny
	$(BIN)/rlbench regress --results $(RESULTS)/tiny --update --baseline tests/tiny.json

# the paper's table, figures and ablations anew, on moving takes of 20 frames: 10 minutes of rendering, an hour of scoring and timing
table1: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(TABLE1)' --preset takes --takes main --spp $(BUDGETS) --out $(RESULTS)/table1
	set -e; for report in table1 paper-pareto ablation; do $(BIN)/rlbench report $$report --results $(RESULTS)/table1 --out docs/made; done
	cp docs/made/*.md docs/made/*.png docs/results && rm -r docs/made

# the same at the paper's 720x720, 5 frames of each take: an hour of rendering, as long for scoring
table1-720: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(TABLE1_720)' --preset takes --takes main --size 720x720 --limit-frames 5 --spp 1,4 --times none --out $(RESULTS)/table1-720
	$(call page,table1,$(RESULTS)/table1-720,table1-720)

# 48 generated scenes that no training used: who leads, and what learned memory and sampling give over rules: 11 minutes of rendering, half an hour of scoring
unseen: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(UNSEEN)' --preset unseen --spp 0.25,0.5,1,2,4 --times none --out $(RESULTS)/unseen
	$(BIN)/rlbench run -m '$(CLAIMED)' --preset unseen --spp 1,4 --times none --out $(RESULTS)/unseen
	$(call page,ablation -m '$(CLAIMED)',$(RESULTS)/unseen,ablation-unseen)
	$(BIN)/rlbench render --preset unseen --digests > docs/results/unseen-clips.txt
	$(call page,clips -m '$(UNSEEN)',$(RESULTS)/unseen,unseen)
	$(BIN)/rlbench report parts --results $(RESULTS)/unseen --out docs/made
	sed -e '1s/.*/\n## Parts of ours/' -e 2,5d docs/made/parts.md >> docs/results/unseen.md && rm -r docs/made

# times by size, backend and precision, and what a frame costs in work and memory: 9 minutes of a quiet machine
speed: .venv/dev.stamp
	$(BIN)/rlbench speed -m '$(SPEED)' --sizes 192,720 --backend eager,openvino --half --repeats 5 --out $(RESULTS)/speed
	cp $(RESULTS)/speed/speed.md $(RESULTS)/speed/speed.csv docs/results

# $(call time_on_gpu,ROWS,BACKEND,FOLDER): time rows at $$size plainly and by a backend, into a folder of results/gpu, unless that was done
define time_on_gpu
out=$(RESULTS)/gpu/$(3); test -f $$out/speed.csv || \
$(BIN)/rlbench speed -m $(1) --sizes $$size --backend eager,$(2) --half --repeats 5 --device $(GPU) --out $$out || exit 1
endef

# on a machine with a GPU: recorded frames and steps against plain ones, cost of samples, and times at three sizes; what is done is kept
gpu: .venv/dev.stamp
	$(BIN)/rlbench doctor
	$(BIN)/python -c 'import torch; assert torch.cuda.is_available(), "make gpu needs a GPU"'
	mkdir -p $(RESULTS)/gpu
	for test in $$(grep -o '^def test_[a-z0-9_]*' tests/test_gpu.py | cut -c5-); do \
	  passed=$(RESULTS)/gpu/$$test; test -f $$passed || \
	  { $(BIN)/python -m pytest tests/test_gpu.py -n 0 -k $$test && touch $$passed; } || exit 1; done
	$(BIN)/python -m pytest tests/test_conformance.py -m gpu -n 0
	$(BIN)/python -m pytest tests/performance/test_bench_sizes.py --benchmark-only -q
	for size in 192 1280x720 1080p; do \
	  $(call time_on_gpu,$(SPEED_GPU),graph,$$size-graph); \
	  for row in $(filter-out oidn-intel,$(subst $(comma), ,$(SPEED_GPU))); do \
	    $(call time_on_gpu,oidn-intel$(comma)$$row,fused,$$size-fused/$$row); done; \
	done

# frames of 1080p, on a machine with a GPU: clips, scores, times, and which row for 120, 60 and 30 frames a second; resumes
# also of the scenes by others, where RLBENCH_SCENES names their folder
hd: .venv/dev.stamp
	$(BIN)/rlbench render --preset $(HD) --scenes $(HD_SCENES) --limit-frames 4
	$(BIN)/rlbench run -m '$(SPEED_GPU)' --preset $(HD) --scenes $(HD_SCENES) --limit-frames 4 --spp 1,2,4 --backend graph --device $(GPU) --out $(RESULTS)/hd
	$(call page,summary,$(RESULTS)/hd,gpu)
	$(BIN)/rlbench report pareto --results $(RESULTS)/hd --out docs/made
	mv docs/made/pareto.png docs/results/gpu-pareto.png && rm -r docs/made
	for ms in 8.3 16.6 33.3; do \
	  printf '\n## Which row for %s ms a frame\n\n```text\n' $$ms; \
	  $(BIN)/rlbench decide --frame-ms $$ms --results $(RESULTS)/hd; test $$? -ne 1 || exit 1; \
	  printf '```\n'; done >> docs/results/gpu.md

# SSIM and MS-SSIM against other libraries at 1080p: a minute of a quiet machine
metric-speed: .venv/dev.stamp
	$(BIN)/python -m tests.performance.metric_speed $(RESULTS)/metric-speed.md

# shares of scoring, and of the suite itself, in a run of the demo's rows: 3 minutes of a quiet machine; clips are rendered and decoded before
overhead: .venv/dev.stamp
	rm -rf $(RESULTS)/overhead
	$(BIN)/rlbench run --preset mini --times none --out $(RESULTS)/overhead
	rm -rf $(RESULTS)/overhead
	$(BIN)/python -m tests.performance.profile_run $(RESULTS)/overhead.md --preset mini --out $(RESULTS)/overhead

# comparison with static cameras, cuts, switched lights and static scenes: half an hour of rendering, as long for scoring
takes: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(TAKES)' --preset takes --spp 0.5,1,2,4 --times none --out $(RESULTS)/takes
	$(call page,clips -m '$(TAKES)',$(RESULTS)/takes,takes)

# rivals that fit or learn on the frames themselves: 40 minutes of rendering, as long for scoring
regressions: .venv/dev.stamp
	$(call regress,takes)
	$(call regress,mini)
	$(call regress,unseen)
	printf '# Rivals without training data\n' > docs/results/regression-rivals.md
	for preset in takes mini unseen; do sed '1s/.*/\n#&/' docs/made/$$preset/last-frames.md; done >> docs/results/regression-rivals.md
	rm -r docs/made

# scenes by others: does the order of our presets hold, and who paints blotches on walls: half an hour of rendering, an hour of scoring
real: .venv/dev.stamp
	set -e; for preset in real mini; do $(BIN)/rlbench run -m '$(BY_OTHERS)' --preset $$preset --spp 0.5,1,2,4 --times none --out $(RESULTS)/$$preset; done
	set -e; for preset in development unseen; do $(BIN)/rlbench run -m '$(EIGHT)' --preset $$preset --spp 0.5,1,2,4 --times none --out $(RESULTS)/$$preset; done
	$(BIN)/rlbench run -m '$(CLAIMED)' --preset real --spp 1,4 --times none --out $(RESULTS)/real
	$(call page,ablation -m '$(CLAIMED)',$(RESULTS)/real,ablation-real)
	$(BIN)/rlbench images -m '$(PAINTED)' --preset real --scenes living-room,staircase2 --out $(RESULTS)/real-images
	mkdir -p docs/made
	set -e; for clip in living-room staircase2; do cp $(RESULTS)/real-images/$$clip-1spp-??.png docs/made/real-$$clip.png; done
	$(BIN)/rlbench report real -m '$(BY_OTHERS)' --results $(RESULTS)/real --against $(RESULTS)/mini,$(RESULTS)/unseen,$(RESULTS)/development --out docs/made
	mv docs/made/real.md docs/made/real-*.png docs/results && rm -r docs/made

# frames of 640x360 beside small ones, do both have one order of rows, and the times and figures of the README: two hours of rendering, as long for scoring and timing
large: .venv/dev.stamp
	set -e; for size in 192x192 640x360; do \
	  $(BIN)/rlbench run -m '$(SIZED)' --preset mini --size $$size --spp 1,4 --times none --out $(RESULTS)/large/mini-$$size && \
	  $(BIN)/rlbench run -m '$(SIZED)' --preset real --size $$size --scenes $(OWN_CAMERAS) --spp 1,4 --times none --out $(RESULTS)/large/real-$$size; done
	set -e; for preset in mini real; do \
	  $(BIN)/rlbench report real -m '$(SIZED)' --results $(RESULTS)/large/$$preset-640x360 --out docs/made \
	    --against $(RESULTS)/large/mini-192x192,$(RESULTS)/large/real-192x192 && \
	  mv docs/made/real.md docs/results/$$preset-640x360.md && rm -r docs/made || exit 1; done
	set -e; for size in 160x160 640x360; do \
	  $(BIN)/rlbench run -m '$(SIZED)' --preset unseen --size $$size --scenes $(TWELVE_UNSEEN) --spp 1,4 --times none --out $(RESULTS)/large/unseen-$$size; done
	$(call page,real -m '$(SIZED)' --against $(RESULTS)/large/unseen-160x160$(comma)$(RESULTS)/large/real-640x360,$(RESULTS)/large/unseen-640x360,unseen-640x360)
	$(BIN)/python -m rlbench.apps.render.jobs.contact_sheet docs/results/real-scenes.png --preset real-640x360 --shrink 2
	$(BIN)/rlbench run -m '$(README)' --preset mini --size 640x360 --spp 0.5,1,2,4 --out $(RESULTS)/large/times
	$(call page,summary -m '$(README)',$(RESULTS)/large/times,mini-640x360-times)
	set -e; for name in pareto winners; do \
	  $(BIN)/rlbench report $$name --results $(RESULTS)/large/times --out docs/made && \
	  mv docs/made/$$name.png docs/results/$$name-eight.png && rm -r docs/made || exit 1; done

# what methods lose after a cut and a switched light, and how long: 9 minutes of rendering, 3 of scoring
recovery: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(RECOVERING)' --preset takes --scenes city-cut,hall-cut,ripples-cut,temple-cut --spp 1 --times none --out $(RESULTS)/recovery
	$(BIN)/rlbench report recovery --results $(RESULTS)/recovery --out docs/made
	mv docs/made/recovery.md docs/made/recovery.png docs/results && rm -r docs/made

# does a memory gather errors over 24 frames: 5 minutes of rendering, 5 of scoring
drift: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(CARRYING)' --preset development-long --spp 1,4 --times none --out $(RESULTS)/drift
	$(call page,summary,$(RESULTS)/drift,drift)

# the picture of the viewer in the README; needs Chromium
viewer: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(VIEWED)' --preset mini --spp 1 --times none --keep-images --out $(RESULTS)/kept
	$(BIN)/rlbench view $(RESULTS)/kept --out $(RESULTS)/kept/report.html
	$(BIN)/python -m tests.apps.view.viewer.take_picture $(RESULTS)/kept/report.html docs/results/viewer.png '$(SHOWN)'

# stress tests of every shipped row with weights of its own; resumes if it was killed; succeeds also where tests fail, since the page lists them
stress: .venv/dev.stamp
	$(BIN)/rlbench stress --out $(RESULTS)/stress || test $$? -eq 1
	$(BIN)/python -m reports.stress_matrix $(RESULTS)/stress docs/results

# gradient estimators of the sampler against an exact gradient: 4 minutes of one core
gradients: .venv/run.stamp
	$(BIN)/python -m methods.ours.gradients.measure --out docs/results
	$(BIN)/python -m research.reports.gradients docs/results

# long trainings of every compared row, on processors that are free: days; resumes. In pieces, on a GPU:
# make campaign CAMPAIGN='--minutes 10 --device cuda --batch 4'; of what memory and samplers learn: QUEUE=memory; rates: QUEUE=rates
campaign: .venv/run.stamp
	$(BIN)/rlbench train --queue research/$(QUEUE).toml --out runs/$(QUEUE) $(CAMPAIGN)

# validation of each row that ships against its training, from the model cards
training: .venv/run.stamp
	$(BIN)/python -m research.reports.training_curves docs/results

# one frame of each scene; resumes if it was killed; make contact SPP=64 is quick
contact: .venv/run.stamp
	$(BIN)/python -m rlbench.apps.render.jobs.contact_sheet docs/results/scenes.png --spp $(SPP)

# the animation of the README: a minute of scoring
teaser: .venv/dev.stamp
	$(BIN)/rlbench run -m mean,oidn,ours --preset mini --spp 1 --scenes city --keep-images --times none --out $(RESULTS)/teaser
	$(BIN)/rlbench video $(RESULTS)/teaser -m mean,oidn,ours --titles 'noisy samples,denoiser without memory,ours' --samples --columns 2 --crop 0,40,192,144 --fps 6 --quality 80 --out $(RESULTS)/teaser/video
	cp $(RESULTS)/teaser/video/city-1spp-mean-oidn-ours.webp docs/results/teaser.webp

# a light that is switched, with and without antilag, and without memory: half an hour of rendering, a minute of scoring
switched: .venv/dev.stamp
	$(BIN)/rlbench run -m ours/lag,ours,oidn-intel --preset takes --spp 4 --scenes hall-cut --keep-images --times none --out $(RESULTS)/switched
	$(BIN)/rlbench video $(RESULTS)/switched -m ours/lag,ours,oidn-intel --titles 'ours without antilag,ours,oidn-intel' --fps 4 --quality 80 --out $(RESULTS)/switched/video
	cp $(RESULTS)/switched/video/hall-cut-4spp-ours-lag-ours-oidn-intel.webp docs/results/switched.webp

# each scene of mini, side by side, in results/videos/video: large files, not committed; two minutes of scoring
videos: .venv/dev.stamp
	$(BIN)/rlbench run -m '$(FILMED)' --preset mini --spp 1 --keep-images --times none --out $(RESULTS)/videos
	$(BIN)/rlbench video $(RESULTS)/videos -m '$(FILMED)' --reference --columns 3 --zoom 2

# documentation and results as a site, in site/; a broken link or an undocumented name fails it
# results are those of the shipped baseline, or of folders: make site SITE_RESULTS=results
site: export RLBENCH_SITE_RESULTS = $(SITE_RESULTS)
site: .venv/docs.stamp
	$(BIN)/mkdocs build

RUN_TESTS = $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder
APP_TESTS := tests/apps tests/research
CORE_TESTS := tests $(addprefix --ignore=,$(APP_TESTS))

# style, types, layers, and the tests of the benchmark and the zoo
test: .venv/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(RUN_TESTS) $(CORE_TESTS)

# of rendering, dumps, viewer and cluster, and of the experiments
test-apps: .venv/dev.stamp
	$(RUN_TESTS) $(APP_TESTS)

# both, and what takes longer than a few seconds
test-all: RUN_TESTS += -m "not gpu"
test-all: test test-apps

# the tests of the benchmark with the lowest versions that pyproject.toml states: a quarter of an hour
lowest: BIN := .venv-lowest/bin
lowest:
	$(PYTHON) -m venv .venv-lowest
	$(BIN)/python tests/lowest_versions.py > .venv-lowest/constraints.txt
	$(BIN)/pip install -qq -c .venv-lowest/constraints.txt -e '.[dev]'
	$(RUN_TESTS) $(CORE_TESTS)

format: .venv/dev.stamp
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv .venv-lowest build site *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis

# entry points are read from installed metadata: a changed pyproject.toml is installed again
.venv/run.stamp: pyproject.toml constraints.txt | $(BIN)/pip
	@echo "installing packages into .venv: a few minutes, 2 to 3 GB"
	@$(INSTALL) -e .
	touch $@

.venv/dev.stamp: pyproject.toml constraints.txt | $(BIN)/pip
	@echo "installing packages and development tools into .venv: a few minutes, 2 to 3 GB"
	@$(INSTALL) -e '.[dev]'
	touch $@ .venv/run.stamp

.venv/docs.stamp: pyproject.toml constraints.txt | $(BIN)/pip
	@echo "installing packages and documentation tools into .venv: a few minutes, 2 to 3 GB"
	@$(INSTALL) -e '.[docs]'
	touch $@ .venv/run.stamp

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "rlbench needs Python 3.11 or newer: make PYTHON=python3.12"'
	@$(PYTHON) -m venv .venv
