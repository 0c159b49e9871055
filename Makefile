# make setup: system libraries and .venv.  make report: the accuracy report.  make test: every check.
# All three set up what is missing first; see .ci/setup, which exits 3 where it may not (make itself then exits 2).
.PHONY: setup report test
# Set-up compiles no module; what is imported is compiled once, not by every process anew.
unexport PYTHONDONTWRITEBYTECODE

setup:
	@bash .ci/setup

report: setup
	.venv/bin/lightgauge report

test: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/pytest -n 2 --dist loadfile
# Types are checked beside the report, which leaves much of a second core idle.
	.venv/bin/lightgauge report --quiet & made=$$!; bash .ci/typecheck; types=$$?; wait $$made && exit $$types
	.venv/bin/lightgauge gate reports/latest --gates gates.toml --every-scene
