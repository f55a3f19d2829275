"""Closed loop over HTTP under attack: a server killed at random moments, and a thousand malformed requests.

Run ``python bench/over_http.py [seed]``. A split is driven ten times while the model server's process is killed once at
a moment drawn by chance, and started again: the rows have to be those of this process. Then a server is sent a thousand
malformed requests: it must say no traceback, keep its memory, and answer as before.
"""

import random
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import httpx2

from adapters.registry import planner
from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.errors import InputError
from benchmark.extensions.http.images import ImageFormat
from benchmark.extensions.http.model import HttpPlanner, http_planner
from benchmark.extensions.http.observed import request_of
from benchmark.runs.driving import DriveSettings, drive_split
from tests.benchmark.extensions.http.made import Painted, free_port, observed
from tests.benchmark.extensions.http.malformed import answered, malformed
from tests.benchmark.fake_data import town_of_two

KILLS, REQUESTS = 10, 1000
SERVED = "constant-velocity"
SETTINGS = DriveSettings("default", DefaultRides(), sensor=Painted())


class Process:
    """A model server as a user starts it, started again by somebody whenever it was killed."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.said = folder / "said"
        self._start()

    def _start(self) -> None:
        command = [sys.executable, "-m", "benchmark", "serve", "--model", SERVED, "--port", str(self.port)]
        with self.said.open("ab") as said:
            self.running = subprocess.Popen(command, stdout=said, stderr=said)
        one, until = http_planner(f"served=http://127.0.0.1:{self.port}"), time.monotonic() + 120.0
        while time.monotonic() < until:
            try:
                return one.require_alive()
            except InputError:
                time.sleep(0.05)
        raise TimeoutError(self.said.read_text())

    def kill(self) -> None:
        """End it at once."""
        self.running.kill()
        self.running.wait()

    def kill_and_start(self, after_s: float) -> None:
        """End it after a while, and start it again."""
        time.sleep(after_s)
        self.kill()
        self._start()

    @property
    def memory_mb(self) -> float:
        """What it holds now."""
        status = Path(f"/proc/{self.running.pid}/status").read_text()
        return float(status.partition("VmRSS:")[2].split()[0]) / 1024


def killed_at_random(seed: int, folder: Path) -> None:
    """Ten drives of two scenes, a kill in each."""
    chance, server = random.Random(seed), Process(folder)
    here = drive_split(town_of_two(), "val", planner(SERVED), folder / "here", SETTINGS)

    def driven(name: str) -> Any:
        one: HttpPlanner = http_planner(f"served=http://127.0.0.1:{server.port}", image_format="png")
        return drive_split(town_of_two(), "val", one, folder / name, SETTINGS)

    started = time.monotonic()
    driven("undisturbed")
    whole_s, same = time.monotonic() - started, 0
    for number in range(KILLS):
        after_s = chance.uniform(0.0, whole_s)
        killer = threading.Thread(target=server.kill_and_start, args=(after_s,))
        killer.start()
        record = driven(str(number))
        killer.join()
        kept = sorted(path.name for path in record.directory.glob("drives/*.json"))
        assert kept == ["scene-9901-0.json", "scene-9902-0.json"], kept
        same += record.rows == here.rows and record.complete
        verdict = "the same" if record.rows == here.rows else "OTHER"
        print(f"  killed after {after_s:.2f} s of {whole_s:.2f} s: {verdict} rows")
    server.kill()
    print(f"killed at random: {same} of {KILLS} drives have the rows of this process, each scene once")
    assert same == KILLS


def malformed_requests(seed: int, folder: Path) -> None:
    """A thousand requests that are none."""
    server = Process(folder)
    good = [request_of(observed(index), ImageFormat.PNG).encoded() for index in range(3)]

    def plans() -> list[str]:
        with httpx2.Client(trust_env=False, verify=False, timeout=60.0) as client:
            url = f"http://127.0.0.1:{server.port}"
            client.post(f"{url}/reset", content=b"{}")
            return [client.post(f"{url}/infer", content=body).text for body in good]

    wanted, statuses = plans(), dict.fromkeys(("nothing", "2", "4", "5"), 0)
    sizes = []
    for number, (sent, whole) in enumerate(malformed(REQUESTS, seed)):
        reply = answered(server.port, sent, whole, 60.0)
        statuses["nothing" if not reply else reply[9:10].decode()] += 1
        if number % (REQUESTS // 5) == REQUESTS // 5 - 1:
            sizes.append(server.memory_mb)
    assert plans() == wanted
    said = server.said.read_text()
    server.kill()
    print(
        f"malformed requests: {REQUESTS}, answered {statuses}; memory {', '.join(f'{size:.0f}' for size in sizes)} MB"
    )
    print(f"tracebacks: {said.count('Traceback')}; it answers as before")
    assert "Traceback" not in said and max(sizes[1:]) < sizes[0] + 16.0


def main(seed: int) -> None:
    for work in (killed_at_random, malformed_requests):
        with tempfile.TemporaryDirectory() as folder:
            work(seed, Path(folder))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
