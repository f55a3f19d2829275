"""Install packages into an environment with pip, and say what is fetched and how much is on disk meanwhile.

``python .ci/install.py [--torch-from INDEX] ENVIRONMENT WHAT...``; WHAT is what ``pip install`` takes. With an index of
builds without CUDA, torch comes from there where no NVIDIA GPU is found. The standard library alone: nothing else is
installed yet.
"""

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

BIG_MB = 5.0
"""Files from this size on are named as they are fetched."""
SILENCE_S = 10.0
"""After so long without a line it is said how much lies on disk."""
FETCHED = re.compile(r"^\s*(?:Downloading|Using cached|Processing) (\S+)(?: \(([\d.]+) (MB|GB)\))?")
ANSWER_S = 5
"""So long an index may take to answer."""


def megabytes(folder: Path) -> int:
    """Space that the files of a folder take, in MB."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) // 10**6


def report_silence(environment: Path, spoken: threading.Event, ended: threading.Event) -> None:
    """Say every `SILENCE_S` how much is on disk, unless something else was said meanwhile."""
    while not ended.wait(SILENCE_S):
        if not spoken.is_set():
            print(f"  {megabytes(environment)} MB on disk", flush=True)
        spoken.clear()


def install(environment: Path, what: list[str]) -> int:
    """Run ``pip install`` and hand on what is worth knowing of its lines; the exit code is pip's."""
    spoken, ended = threading.Event(), threading.Event()
    threading.Thread(target=report_silence, args=(environment, spoken, ended), daemon=True).start()
    command = [*pip(environment), "install", "--progress-bar", "off", *what]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as running:
        for line in running.stdout or ():
            said = worth_saying(line.rstrip())
            if said:
                spoken.set()
                print(said, flush=True)
    ended.set()
    return running.returncode


def worth_saying(line: str) -> str | None:
    """What a line of pip is to a reader: an error, a big file, the beginning of unpacking; else nothing."""
    if line.lstrip().lower().startswith("error"):
        return line
    fetched = FETCHED.match(line)
    if fetched and fetched.group(2):
        size = float(fetched.group(2)) * (1000 if fetched.group(3) == "GB" else 1)
        return f"  {fetched.group(1).rpartition('/')[2]} ({size:.0f} MB)" if size >= BIG_MB else None
    if line.startswith("Installing collected packages:"):
        return f"  unpacking {line.count(',') + 1} packages"
    return None


def pip(environment: Path) -> list[str]:
    """How pip of an environment is called."""
    return [str(environment / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]


def install_torch(environment: Path, index: str, pinned: str) -> None:
    """Take torch without CUDA from its own index, where there is no GPU; else say what pip's own choice costs."""
    if Path("/dev/nvidia0").exists() or shutil.which("nvidia-smi"):
        print("an NVIDIA GPU is here: torch with CUDA, some 6 GB on disk", flush=True)
        return
    if answers(f"{index}/torch/"):
        if install(environment, ["--no-deps", "--index-url", index, pinned]) == 0:
            print("no GPU here: torch without CUDA, from PyTorch's own index", flush=True)
            return
        why = "PyTorch's index has no build without CUDA for this machine"
    else:
        why = "PyTorch's index of builds without CUDA does not answer"
    if brings_cuda(environment, pinned):
        print(
            f"{why}, and the {pinned} that pip finds brings CUDA libraries along: some 6 GB on disk. If that is too"
            " much, stop here (Ctrl-C) and name an index that has builds without CUDA: make TORCH_CPU=https://... demo",
            flush=True,
        )


def stop_waiting(_signal: int, _frame: object) -> None:
    """End the attempt to reach an index; Ctrl-C stays what it is."""
    raise TimeoutError


def answers(address: str) -> bool:
    """Whether an index answers in time."""
    signal.signal(signal.SIGALRM, stop_waiting)
    signal.alarm(ANSWER_S)
    try:
        with urllib.request.urlopen(address, timeout=ANSWER_S):
            return True
    except (OSError, ValueError):
        return False
    finally:
        signal.alarm(0)


def brings_cuda(environment: Path, pinned: str) -> bool:
    """Whether the build of torch that pip would take asks for NVIDIA's libraries."""
    asked = [*pip(environment), "install", "--quiet", "--dry-run", "--no-deps", "--report", "-", pinned]
    told = subprocess.run(asked, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    try:
        wanted = [each["metadata"].get("requires_dist", []) for each in json.loads(told.stdout)["install"]]
    except (ValueError, KeyError):
        return False
    return any(re.match(r"(nvidia|cuda|triton)\b", name) for names in wanted for name in names)


def main() -> int:
    """Install, and end as pip ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--torch-from", metavar="INDEX", help="index of builds of torch without CUDA")
    parser.add_argument("environment", type=Path)
    parser.add_argument("what", nargs=argparse.REMAINDER, help="what pip install takes")
    given = parser.parse_args()
    if given.torch_from and sys.platform == "linux":
        constraints = (Path(__file__).resolve().parents[1] / "constraints.txt").read_text()
        pinned = re.search(r"^torch==\S+", constraints, re.MULTILINE)
        assert pinned is not None, "constraints.txt pins torch"
        install_torch(given.environment, given.torch_from.rstrip("/"), pinned.group())
    return install(given.environment, given.what)


if __name__ == "__main__":
    sys.exit(main())
