"""The outcome of a check: it holds, it fails, or it was not judged.

Everything that tells people whether something is so, such as certificates, lift reports, site pages
and claims of experiments, prints from a `Check`. A check has three verdicts and not two, because
what was not computed is neither right nor wrong.

    >>> checks = [Check("The rope stays taut.", True), Check("No wind was entered.", None)]
    >>> overall(checks)
    <Verdict.NOT_JUDGED: 'not judged'>
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np


class Verdict(Enum):
    """The outcome of a check, or of several checks together."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_JUDGED = "not judged"

    @classmethod
    def of(cls, holds: bool | np.bool_ | Verdict | None) -> Verdict:
        """Return the verdict of a condition: None, for a condition that was not computed, is
        `NOT_JUDGED`.

        Raises:
            TypeError: If the condition is anything else, such as a number. A NaN must not become a
                verdict by its truth value, which is true.
        """
        if isinstance(holds, Verdict):
            return holds
        if holds is None:
            return cls.NOT_JUDGED
        if not isinstance(holds, bool | np.bool_):
            raise TypeError(f"A check holds (True), fails (False) or is not judged (None): {holds}")
        return cls.HOLDS if holds else cls.FAILS

    @property
    def word(self) -> str:
        """The word that is printed before a check, in capitals where it must be seen."""
        return "FAILS" if self is Verdict.FAILS else self.value


@dataclass(frozen=True, init=False)
class Check:
    """A requirement and its outcome.

    Attributes:
        sentence: What was checked, with its numbers. If it was not judged: why it was not.
        verdict: Whether it holds.
        name: A name that stays the same whatever the sentence says, by which a stored check is
            found again; empty if it has none. Checks of different names may be equal.
    """

    sentence: str
    verdict: Verdict
    name: str = field(default="", compare=False)

    def __init__(
        self, sentence: str, holds: bool | np.bool_ | Verdict | None, name: str = ""
    ) -> None:
        """Keep the sentence, the verdict and the name.

        Args:
            sentence: See the attribute.
            holds: A verdict, or a condition: None if it was not judged.
            name: See the attribute.

        Raises:
            TypeError: If `holds` is neither.
        """
        object.__setattr__(self, "sentence", sentence)
        object.__setattr__(self, "verdict", Verdict.of(holds))
        object.__setattr__(self, "name", name)

    def __str__(self) -> str:
        """Return the verdict and the sentence in one line."""
        return f"{self.verdict.word}: {self.sentence}"

    @property
    def holds(self) -> bool | None:
        """True if it holds, False if it fails, None if it was not judged; only True is true."""
        return {Verdict.HOLDS: True, Verdict.FAILS: False}.get(self.verdict)

    def stored(self) -> dict[str, str | bool | None]:
        """Return the check as it is written to JSON."""
        return {"sentence": self.sentence, "holds": self.holds}


def overall(checks: Iterable[Check]) -> Verdict:
    """Return the verdict of several checks together.

    It fails if one of them fails. It holds only if all of them hold and there is at least one:
    where nothing was checked, nothing was judged.
    """
    verdicts = {check.verdict for check in checks}
    if Verdict.FAILS in verdicts:
        return Verdict.FAILS
    return Verdict.HOLDS if verdicts == {Verdict.HOLDS} else Verdict.NOT_JUDGED
