"""Fuzzing for as long as one likes: ``python -m tests.system.fuzz --count 100000 --only sweep``.

Prints every case that breaks a promise, and at the end how many ended in which way.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

import pytest

from tests.system.fuzz import api, files, lines
from tests.system.fuzz.core import drawn, judged

GENERATORS = {one.name: one for module in (lines, files, api) for one in module.GENERATORS}
"""All generators by name."""


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz; return 0 if every promise was kept, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="inputs in all")
    parser.add_argument("--seed", type=int, default=0, help="first number of each generator")
    parser.add_argument("--only", nargs="+", default=[""], help="words in names of generators")
    parser.add_argument("--again", metavar="NAME/NUMBER", help="try one case")
    options = parser.parse_args(argv)
    names = [name for name in GENERATORS if any(word in name for word in options.only)]
    count = options.count // len(names) or 1
    first = options.seed
    if options.again:
        name, _, number = options.again.rpartition("/")
        names = [name]
        count = 1
        first = int(number)
    endings: Counter[tuple[str, str]] = Counter()
    for name in names:
        for number in range(first, first + count):
            print(f"{name}/{number}", end="\r", file=sys.stderr, flush=True)  # in case it crashes
            try:
                case = drawn(GENERATORS[name], number)
            except pytest.skip.Exception as reason:  # of an extra that is not installed
                print(f"{name}: {reason}")
                break
            word, fault = judged(GENERATORS[name], case)
            endings[name, word] += 1
            if fault:
                print(f"* {name}/{number}: {case}\n{fault}", flush=True)
    for (name, word), number in sorted(endings.items()):
        print(f"{name:24} {word:14} {number:9,d}")
    return 1 if any(word == "broken" for _, word in endings) else 0


if __name__ == "__main__":
    raise SystemExit(main())
