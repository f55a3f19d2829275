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

    Capitals make no difference.
    """
    spelled = {each.lower(): each for each in sorted(set(known))}
    close = [spelled[match] for match in difflib.get_close_matches(name.lower(), sorted(spelled))]
    *others, last = close or [""]
    return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}? " if last else ""
