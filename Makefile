# Each target sets up what it needs, see environment/run.
RUN := environment/run
SIZE := default
PYTEST := python3 -m pytest -p no:cacheprovider
# Python translates a file once, not in every process again.
export PYTHONDONTWRITEBYTECODE :=

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile

demo: ## ball on plate with both schemes
	@mkdir -p results
	@cd results && ../$(RUN) python3 ../demos/demo_ball_plate.py

bench: ## run time against error, and methods and laws of contact, SIZE=default (17 to 25 minutes) or full
	$(RUN) python3 -m benchmarks --size $(SIZE)
	$(RUN) python3 -m benchmarks.defaults
	@echo "The results lie in $(CURDIR)/results/bench"

bench-peers: ## the first impact in CalculiX, GetFEM and by IPC, judged by one routine (10 minutes)
	$(RUN) python3 -m benchmarks.peers
	@echo "The results lie in $(CURDIR)/results/bench"

bench-publish: ## put figures and tables of the last bench into the documentation
	$(RUN) python3 -m benchmarks.publish

verification: ## closed forms, other programs, published data: table of the page (10 minutes)
	$(RUN) $(PYTEST) --publish

test: test-one-rank test-ranks ## all tests, and on 2 and 3 ranks those that ranks can change

test-one-rank: ## those on one rank, in two processes
	$(RUN) $(PYTEST) --numprocesses 2 --dist worksteal -m "not alone and not several_ranks"

test-ranks: ## those on 2 and 3 ranks, and those that measure wall time: nothing runs beside them
	$(RUN) $(PYTEST) -m alone
	$(RUN) environment/ranks 2 $(PYTEST) -m "not serial"
	$(RUN) environment/ranks 3 $(PYTEST) -m "not serial and not at_most_two_ranks"

test-latest: export DOLFINX_NTS_SUITE := sid
test-latest: test ## the same on the newest DOLFINx, that of Debian unstable

stress: ## scenes that try to break a run, tables results/stress.csv, docs/tables/stress.md and tumbling.md; 10 000 steps
	$(RUN) python3 -m stress.run
	$(RUN) python3 -m stress.endurance
	$(RUN) python3 -m stress.tumbling

sanitize: ## tests of the kernels under address and undefined-behaviour sanitizers
	$(RUN) environment/sanitize

coverage: ## lines that the tests on one rank execute, table and pages in build/coverage
	$(RUN) environment/coverage

traps: ## all tests on one rank, with floating-point traps
	$(RUN) env NTS_TRAPS=1 $(PYTEST)

lint: ## ruff, mypy, clang-format, shellcheck
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) python3 -m mypy --strict dolfinx_nts
	$(RUN) clang-format --dry-run -Werror $$(find dolfinx_nts -name '*.h' -o -name '*.cpp')
	$(RUN) shellcheck --external-sources --source-path=SCRIPTDIR environment/run environment/ranks environment/sanitize environment/coverage environment/instrumented.sh .ci/run

docs: ## the documentation site with executed demos, in build/docs/html
	$(RUN) python3 -m sphinx --fail-on-warning --keep-going --quiet -d build/docs/doctrees docs build/docs/html
	@echo "The site begins with $(CURDIR)/build/docs/html/index.html"

docs-quick: ## the site without running demos, in build/docs/quick
	$(RUN) python3 -m sphinx --fail-on-warning --keep-going --quiet -D nb_execution_mode=off -D suppress_warnings=myst-nb.lexer -d build/docs/quick-doctrees docs build/docs/quick

shell: ## a prompt in the environment
	@$(RUN) env PS1='(dolfinx_nts) \w\$$ ' bash --norc

clean: ## remove what was built and say where the environment lies
	rm -rf build results .mypy_cache .pytest_cache .ruff_cache dolfinx_nts/_kernels.*.so
	find . -name __pycache__ -prune -exec rm -rf {} +
	@echo "The environment stays in $${XDG_CACHE_HOME:-$$HOME/.cache}/dolfinx_nts"

.PHONY: help demo docs docs-quick bench bench-peers bench-publish verification test test-one-rank test-ranks test-latest stress sanitize coverage traps lint shell clean
