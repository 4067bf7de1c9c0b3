"""Numbers and words that nobody should give."""

from __future__ import annotations

NUMBERS = (
    "0 -0 0.0 -1 1e300 -1e300 1e-300 1e308 -1e308 5e-324 1e-310 nan inf -inf 1e400 1e-400 "
    "1e29 1e-20 1e9 1e15 -1e-9"
).split()
NUMBERS += [
    "9" * 300,
    "1" * 5000,
    "0x10",
    "1_0",
    "١",
    "1e",
    "--1",
    "1,5",
    "",
    " ",
    "+1",
    "1.",
    ".5",
    "99999999999999999999",
    "1e-8",
    "1e5",
]
"""Where a number is asked for."""

SMALL_COUNTS = ["1", "2", "0", "-1", "3", "1.0", "99999999999999", "1e3", ""]
"""Where a whole number is asked for; small ones, so that nothing takes all processors."""

LETTERS = [
    "",
    " ",
    "\0",
    "a\0b",
    "\udcff",
    "a\udc80",
    "a" * 300,
    "a\nerror: forged",
    "\x1b[31m",
    "\u2028",
    "ä" * 200,
    "-",
    "${1/0}",
    "$(id)",
    "%s",
    "{0}",
    "..",
    "/",
]
"""Where a word is asked for."""
