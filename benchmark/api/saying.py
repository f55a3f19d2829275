"""How functions of the public face say something to the person who waits."""

import sys


def tell(sentence: str) -> None:
    """Say something to the person who waits; stdout stays free for results."""
    print(sentence, file=sys.stderr, flush=True)


_said: set[str] = set()


def say_once(sentence: str) -> None:
    """Say what holds for a whole command, however often it is found out."""
    if sentence not in _said:
        _said.add(sentence)
        tell(sentence)
