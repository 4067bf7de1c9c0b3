"""Fuzzing for as long as one likes: ``python -m tests.system.fuzz --count 100000 --only sweep``.

Prints every case that breaks a promise, and at the end how many ended in which way.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence

from tests.system.fuzz.generators import GENERATORS
from tests.system.fuzz.pool import tried


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz; return 0 if every promise was kept, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="inputs in all")
    parser.add_argument("--seed", type=int, default=0, help="first number of each generator")
    parser.add_argument("--only", nargs="+", default=[""], help="words in names of generators")
    parser.add_argument("--again", metavar="NAME/NUMBER", help="try one case")
    options = parser.parse_args(argv)
    if options.again:
        name, _, number = options.again.rpartition("/")
        counts, options.seed = {name: 1}, int(number)
    else:
        names = [name for name in GENERATORS if any(word in name for word in options.only)]
        weight = sum(GENERATORS[name].weight for name in names)
        counts = {
            name: round(options.count * GENERATORS[name].weight / weight) or 1 for name in names
        }
    ended: Counter[tuple[str, str]] = Counter()
    for name, count in counts.items():
        for case in tried(name, range(options.seed, options.seed + count)):
            ended[name, case.verdict.word] += 1
            if case.verdict.place:
                print(case, flush=True)
    for (name, word), count in sorted(ended.items()):
        print(f"{name:24} {word:14} {count:9,d}")
    return 1 if any(word == "broken" for _, word in ended) else 0


if __name__ == "__main__":
    raise SystemExit(main())
