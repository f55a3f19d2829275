"""Damaged 123D logs, as many as one likes: each is imported or refused in one sentence, in bounded memory.

    python -m bench.damaged_logs --count 300

Exits 1 if one ends otherwise: in a traceback, with tables in the root, or beyond 2 GB in a process.
"""

import argparse
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmark.errors import InputError
from generation.extensions.logs123d.importing import LogImport, import_123d
from tests.generation.extensions.logs123d.damaged_logs import damage
from tests.generation.extensions.logs123d.made_logs import MadeLog

MOST_BYTES = 2 << 30


def attempt(valid: Path, folder: Path, number: int, seed: int) -> tuple[str, str]:
    """How one damaged log ended, in a word, and what was said."""
    shutil.copytree(valid, folder / "data", symlinks=True)
    (log,) = (path.parent for path in (folder / "data").rglob("sync.arrow"))
    found, name = damage(log, number, seed)
    root = folder / "root"
    try:
        import_123d(folder / "data" / "logs", root, LogImport())
    except InputError as error:
        tables = list(root.glob("v*/*")) + list(root.glob("samples/*/*")) + list(root.rglob(".*.part"))
        ended = "one sentence" if "\n" not in str(error) and not tables else "half-written"
        return ended, f"{found.name} in {name}: {error}"
    except Exception as error:
        return "traceback", f"{found.name} in {name}: {type(error).__name__}: {error}"
    return ("read" if found.may_be_valid else "damage not seen"), f"{found.name} in {name}"


def main() -> int:
    """Try them; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    wrong, start = 0, time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        valid = Path(temporary) / "valid"
        MadeLog(frames=11).write(valid)
        for number in range(options.first, options.first + options.count):
            folder = Path(temporary) / "case"
            ended, said = attempt(valid, folder, number, options.seed)
            counts[ended] += 1
            wrong += ended not in ("one sentence", "read")
            print(f"{number} {ended}: {said}", flush=True)
            shutil.rmtree(folder, ignore_errors=True)
    peaks = [resource.getrusage(who).ru_maxrss * 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"{dict(counts)}; at most {peaks[0] >> 20} MB here and {peaks[1] >> 20} MB in a child, ", end="")
    print(f"{(time.monotonic() - start) / options.count:.1f} s each")
    return 1 if wrong or max(peaks) > MOST_BYTES else 0


if __name__ == "__main__":
    sys.exit(main())
