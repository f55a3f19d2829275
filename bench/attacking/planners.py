"""Planners that are anything but, each as a module of its own: the table ``planners.toml`` beside this file."""

import tomllib
from pathlib import Path
from typing import Final

_GOOD: Final = """
import os, sys, time, threading
import numpy as np
from benchmark.planning import Plan, PlanFrame

class Good:
    name = "good"
    def reset(self, scene): pass
    def plan(self, observation): return Plan(np.zeros((6, 2)), PlanFrame.EGO)

"""
_CLASS: Final = f"{_GOOD}class Planner(Good):\n    "
_BEFORE: Final = {
    "plan": f"{_CLASS}def plan(self, observation):\n        ",
    "class": _CLASS,
    "module": _GOOD,
    "source": "",
}
"""What stands before each kind of source."""
_SAID: Final[dict[str, dict[str, str]]] = tomllib.loads((Path(__file__).parent / "planners.toml").read_text())
ODD_PLANNERS: Final = {
    name: _BEFORE[kind] + source + "\n" * bool(source) for name, said in _SAID.items() for kind, source in said.items()
}
"""Source of each by what is odd."""
