"""The root of examples/own_recordings, made once a process, and copies of it with other names."""

import atexit
import json
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[4]
SCRIPT = ROOT / "examples" / "own_recordings" / "make_root.py"
VERSION = "v1.0-own"


@cache
def make_root() -> Path:
    """The root as the script leaves it; not to be changed."""
    folder = Path(tempfile.mkdtemp(prefix="own-"))
    atexit.register(shutil.rmtree, folder)
    subprocess.run([sys.executable, SCRIPT, folder / "mine"], check=True)
    return folder / "mine"


def copy_root(target: Path, names: Any = None) -> Path:
    """A copy whose tables can be edited; ``names`` take the place of its file of names, text as it is."""
    made = make_root()
    target.mkdir(parents=True)
    (target / "samples").symlink_to(made / "samples")
    for folder in ("maps", VERSION):
        shutil.copytree(made / folder, target / folder)
    if names is not None:
        text = names if isinstance(names, str) else json.dumps(names)
        (target / VERSION / "own_recordings.json").write_text(text)
    return target
