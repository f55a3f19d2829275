"""Spoiled messages against `serve --protocol alpasim`: `python -m bench.messages [COUNT] [SEED]`.

The server is the command, in a process of its own. It has to answer every call, write no traceback, hold no more memory
in the second half than it did in the first, and serve a sound session at the end.
"""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import grpc

from tests.benchmark.extensions.alpasim.malformed import malformed, sound_requests

MOST_MORE_MB = 64.0
DEADLINE_S = 60.0


def resident_mb(pid: int) -> float:
    (found,) = re.findall(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(found) / 1024


def send(channel: grpc.Channel, path: str, data: bytes) -> str:
    try:
        channel.unary_unary(path)(data, timeout=DEADLINE_S)
    except grpc.RpcError as error:
        return str(error.code().name)
    return "OK"


def main(count: int = 1000, seed: int = 0) -> int:
    command = [
        sys.executable,
        "-m",
        "benchmark",
        "serve",
        "--protocol",
        "alpasim",
        "--model",
        "vad-mini",
        "--port",
        "0",
    ]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert server.stderr is not None
    said = ""
    while "served at" not in said:
        said = server.stderr.readline()
        if not said:
            return 1
    (address,) = re.findall(r"grpc://(\S+),", said)
    codes: Counter[str] = Counter()
    halves = []
    with grpc.insecure_channel(address) as channel:
        for half in range(2):
            for path, data in malformed(count // 2, seed + half):
                codes[send(channel, path, data)] += 1
            halves.append(resident_mb(server.pid))
        send(channel, *sound_requests()[-1])
        sound = [send(channel, path, data) for path, data in sound_requests()]
    server.terminate()
    rest = server.communicate()[0] if server.stderr is None else server.stderr.read()
    server.wait()
    unknown = sum(codes[name] for name in ("UNKNOWN", "UNAVAILABLE", "DEADLINE_EXCEEDED"))
    wrong = [
        *(["a traceback"] if "Traceback" in rest else []),
        *([f"{unknown} calls without an answer"] if unknown else []),
        *([f"memory grew from {halves[0]:.0f} to {halves[1]:.0f} MB"] if halves[1] > halves[0] + MOST_MORE_MB else []),
        *([f"a sound session gets {sound}"] if set(sound) != {"OK"} else []),
    ]
    print(
        f"{count} spoiled messages: {dict(codes)}; {halves[0]:.0f} and {halves[1]:.0f} MB; {', '.join(wrong) or 'ok'}"
    )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
