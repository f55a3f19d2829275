"""Pieces that measure nothing, in a module that imports little: each runs in a process of its own."""

import os
import time
from typing import Any

from bench.gpu_day.pieces import Piece, Setting
from benchmark.machine.storage import write_json


def told(figures: dict[str, Any]) -> str:
    return f"counted {figures['count']}"


def count(setting: Setting) -> dict[str, Any]:
    return {"count": 3}


def breaks(setting: Setting) -> dict[str, Any]:
    raise ValueError("no memory\nat all")


def sleeps(setting: Setting) -> dict[str, Any]:
    write_json(setting.folder / "process.json", os.getpid())
    time.sleep(600)
    return {}


def so_far(setting: Setting) -> dict[str, Any]:
    return {"step": 7}


COUNT, BREAKS = Piece("count", "counts", count, told), Piece("breaks", "breaks", breaks, told)
LONG = Piece("long", "takes long", sleeps, told, so_far)
WHOLE = Piece("whole", "takes long , so it is not cut", sleeps, told)
