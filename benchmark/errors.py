"""The one exception that a user is meant to read, and what helps after a slip of the finger."""

import difflib
from collections.abc import Iterable


class InputError(Exception):
    """Bad input or wrong use: one sentence that says what is wrong, where, and what to do.

    The command line prints it without a traceback and exits with code 2. Anything else that escapes is a defect
    of this project and keeps its traceback.
    """


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Question on the closest three names at most, ``did you mean uniad or uniad-mini? ``; empty if none is close.

    Capitals make no difference; of names that are equally close the first ones are taken.
    """
    spelled = {each.lower(): each for each in sorted(set(known))}
    ratios = {each: difflib.SequenceMatcher(None, each, name.lower()).ratio() for each in spelled}
    close = [spelled[each] for each in sorted(spelled, key=ratios.__getitem__, reverse=True) if ratios[each] >= 0.6][:3]
    *others, last = close or [""]
    return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}? " if last else ""
