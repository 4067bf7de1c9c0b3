"""Fuzzing for as long as one likes: ``python -m tests.system.fuzz --count 1000000 --seed 0 [--only
NAME ...] [--minutes M]``.

Prints for every generator how many inputs it tried and how they ended, and every place where a
promise is broken with the number of the first case and the smallest input that was found for it. It
goes on after a failure; Ctrl-C ends it with what it has.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence

from tests.system.fuzz.core import Found, drawn, listed
from tests.system.fuzz.generators import GENERATORS
from tests.system.fuzz.pool import Count, Workers, blocks, report


def main(argv: Sequence[str] | None = None) -> int:
    """Fuzz; 0 if every promise was kept, 1 if not, 2 for bad arguments."""
    options = _options(argv)
    names = [
        name
        for name in GENERATORS
        if not options.only
        or any(word in (name, *name.replace(",", "").split()) for word in options.only)
    ]
    if not names:
        print(
            f"error: No generator has the word {' or '.join(options.only)} in its name; there are "
            f"{', '.join(GENERATORS)}.",
            file=sys.stderr,
        )
        return 2
    workers = Workers(options.jobs)
    try:
        if options.again:
            return _again(options.again, workers)
        weight = sum(GENERATORS[name].weight for name in names)
        counts = {
            name: round(options.count * GENERATORS[name].weight / weight) or 1 for name in names
        }
        count = workers.run(
            blocks(counts, options.seed),
            until=time.monotonic() + 60.0 * options.minutes,
            tell=_Teller(),
        )
        print("Looking for the smallest inputs …", file=sys.stderr)
        try:
            workers.shrink(list(count.found.values()))
        except KeyboardInterrupt:
            print("Interrupted; not all are the smallest.", file=sys.stderr)
        print(report(count))
        return 1 if count.found else 0
    finally:
        workers.close()


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.system.fuzz",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument(
        "--count",
        type=int,
        default=10_000,
        metavar="N",
        help="how many inputs in all (default 10,000)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="S",
        help="number of the first case of each generator (default 0)",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="NAME",
        help="generators that have one of these words in their names",
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), metavar="M", help="end after so many minutes"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=len(os.sched_getaffinity(0)),
        metavar="J",
        help="processes (default one a processor)",
    )
    parser.add_argument("--again", metavar="NAME/NUMBER", help="try one case and say all about it")
    return parser.parse_args(argv)


def _again(which: str, workers: Workers) -> int:
    name, _, number = which.rpartition("/")
    case = drawn(GENERATORS[name], int(number))
    verdict = workers.judge(name, case)
    print(f"{GENERATORS[name].shown(case)}\n{verdict.word}")
    if verdict.place:
        print(listed([Found(name, int(number), case, verdict)], GENERATORS), verdict.text, sep="\n")
    return 1 if verdict.place else 0


class _Teller:
    """Says how far it is, on standard error, every ten seconds and whenever something is found."""

    def __init__(self) -> None:
        self._began = self._said = time.monotonic()

    def __call__(self, count: Count, found: Found | None) -> None:
        now = time.monotonic()
        if found is not None:
            print(f"{found.name}/{found.number}: {found.verdict.place}", file=sys.stderr)
        elif now < self._said + 10.0:
            return
        self._said = now
        total = count.tried.total()
        print(
            f"{now - self._began:7.0f} s  {total:,} tried, {len(count.found)} places",
            file=sys.stderr,
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
