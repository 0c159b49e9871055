# make setup: system libraries and .venv.  make report: the accuracy report.  make test: every check.
# All three set up what is missing first; see .ci/setup, which exits 3 where it may not (make itself then exits 2).
.PHONY: setup report test

setup:
	@bash .ci/setup

report: setup
	.venv/bin/lightgauge report

test: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
# The report is made beside the tests: it leaves much of a second core idle, as they do towards their end. A failed test ends it.
	.venv/bin/lightgauge report --quiet & made=$$!; \
	trap "kill $$made 2>/dev/null" EXIT; trap "exit 130" INT; \
	.venv/bin/pytest -n 2 --dist loadfile && bash .ci/typecheck && wait $$made
	.venv/bin/lightgauge gate reports/latest --gates gates.toml --every-scene
