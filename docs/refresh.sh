#!/usr/bin/env bash
# Every table of the documents from the results in out/; results that are missing are made first, which takes a quarter of an hour on two processors.
# Run from the top of the repository. Without --write the last command says which cells are stale; the tests hold the documents to it.
set -euo pipefail
python=${PYTHON:-.venv/bin/python}
"$python" -m experiments.report
"$python" -m experiments.harness.document --write docs/results/*.md
