"""Words of sentences that depend on numbers, and of commands that a sentence names."""

import shlex


def pluralise(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun, singular where it is one: ``1 scene``, ``3 scenes`` or ``1,204 samples``.

    ``many`` is by default with an s, or ``ies`` for a ``y`` after a consonant.
    """
    return f"{count:,} {inflect_noun(count, one, many)}"


def inflect_noun(count: int, one: str, many: str | None = None) -> str:
    """The noun of `pluralise` alone, for sentences in which the number stands apart."""
    if count == 1:
        return one
    if many is not None:
        return many
    return f"{one[:-1]}ies" if one.endswith("y") and one[-2] not in "aeiou" else f"{one}s"


def spell_name(name: str) -> str:
    """A stored name as people read it: ``against traffic``."""
    return name.replace("_", " ")


def format_split(split: str, data_name: str) -> str:
    """A split and its data set, as ``split adv of mini``; a data set that is called like its split is named once."""
    return f"split {split}" if data_name == split else f"split {split} of {data_name}"


def format_title(data_name: str, split: str) -> str:
    """The same as the beginning of a title: ``mini, split adv``."""
    return f"split {split}" if data_name == split else f"{data_name}, split {split}"


def format_options(**given: object) -> str:
    """Options of a command, each with a space before it and quoted for a shell; ``None`` and nothing are left out."""
    words: list[str] = []
    for name, value in given.items():
        for part in value if isinstance(value, list | tuple) else () if value is None else (value,):
            words += [f"--{name.replace('_', '-')}", str(part)]
    return "".join(f" {shlex.quote(word)}" for word in words)
