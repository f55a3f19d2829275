"""Write the snapshots of the face, the options and the JSON anew, and say what CHANGELOG.md does not mention yet.

    python -m tests.promise.renew

takes about half a minute and exits 1 while a name that is gone or no longer as it was is not in the unreleased part of
CHANGELOG.md. ``--released`` is for the day of a release: what is promised from then on is what stands there now; it
does so only when every new name is in that part too.
"""

import sys
import tempfile
from pathlib import Path

from tests.promise.said import said, small_town
from tests.promise.snapshots import CHANGELOG, KEPT, SNAPSHOTS, broken_unsaid, gone_unsaid, stored, unsaid
from tests.promise.surface import joined


def main() -> int:
    """Renew; the exit code."""
    changelog, broken, new = CHANGELOG.read_text(), [], []
    with tempfile.TemporaryDirectory() as folder:
        printed = said(small_town(Path(folder) / "town"), Path(folder) / "out")
    present = {**{name: now() for name, now in SNAPSHOTS.items()}, "json": printed}
    for name, now in present.items():
        before, promised = set(stored(name)), stored(name, "then")
        for line in sorted(before ^ set(now)):
            print(f"{'-' if line in before else '+'} {line}")
        (KEPT / f"{name}-now.txt").write_text(joined(now))
        broken += (gone_unsaid if name == "json" else broken_unsaid)(promised, now, changelog)
        new += [] if name == "json" else unsaid(promised, now, changelog)
    new = [word for word in dict.fromkeys(new) if word not in broken]
    for what, words in (("gone or changed", broken), ("new", new)):
        if words:
            print(f"{what}, and not in the unreleased part of CHANGELOG.md: {', '.join(words)}")
    if "--released" in sys.argv and not (broken or new):
        for name, now in present.items():
            (KEPT / f"{name}-then.txt").write_text(joined(now))
    return 1 if broken or (new and "--released" in sys.argv) else 0


if __name__ == "__main__":
    sys.exit(main())
