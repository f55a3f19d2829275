"""Planners that are anything but: what a stranger's class may be or do, each as a module of its own."""

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


def _class(body: str) -> str:
    return f"{_GOOD}\nclass Planner(Good):\n    {body}\n"


def _plan(body: str) -> str:
    return _class(f"def plan(self, observation):\n        {body}")


ODD_PLANNERS: Final[dict[str, str]] = {
    "a good one": _class("pass"),
    "no class": f"{_GOOD}\nPlanner = 3\n",
    "a module": f"{_GOOD}\nPlanner = os\n",
    "a function that gives nothing": f"{_GOOD}\ndef Planner(): pass\n",
    "a class that needs arguments": _class("def __init__(self, a, b): pass"),
    "no reset": f"{_GOOD}\nclass Planner:\n    name = 'x'\n    plan = Good.plan\n",
    "no plan": f"{_GOOD}\nclass Planner:\n    name = 'x'\n    reset = Good.reset\n",
    "plan is a number": _class("plan = 3"),
    "no name": f"{_GOOD}\nclass Planner:\n    reset = Good.reset\n    plan = Good.plan\n",
    "name is None": _class("name = None"),
    "name is a number": _class("name = 7"),
    "name is empty": _class("name = ''"),
    "name is bytes": _class("name = b'good'"),
    "name is a path": _class("name = '../../../x'"),
    "name has a null byte": _class("name = 'a\\0b'"),
    "name is half a character": _class("name = '\\udcff'"),
    "name is long": _class("name = 'x' * 100000"),
    "name changes": _class("@property\n    def name(self): return str(time.monotonic_ns())"),
    "name raises": _class("@property\n    def name(self): raise RuntimeError('no name')"),
    "settings is a list": _class("settings = [1]"),
    "settings holds NaN": _class("settings = {'a': float('nan')}"),
    "settings holds itself": _class("settings = {}\nPlanner.settings['a'] = Planner.settings"),
    "settings has keys of many kinds": _class("settings = {1: 2, None: 3, 'a': 4}"),
    "settings raises": _class("@property\n    def settings(self): raise KeyError('x')"),
    "seed is text": _class("seed = 'seven'"),
    "seed is huge": _class("seed = 10 ** 400"),
    "weights is a folder": _class("weights = '/'"),
    "weights is a number": _class("weights = 3.5"),
    "privileged is text": _class("privileged = 'no'"),
    "every attribute is there": _class("def __getattr__(self, name): return self"),
    "every attribute raises": _class("def __getattr__(self, name): raise ValueError(name)"),
    "its class cannot be printed": _class("def __repr__(self): raise RuntimeError('no')\n    __str__ = __repr__"),
    "raises": _plan("raise RuntimeError('no idea')"),
    "raises what cannot be printed": _plan(
        "class Odd(Exception):\n            def __str__(self): raise ValueError('x')\n        raise Odd()"
    ),
    "raises without an end": _plan("return self.plan(observation)"),
    "raises BaseException": _plan("raise BaseException('odd')"),
    "raises GeneratorExit": _plan("raise GeneratorExit"),
    "raises KeyboardInterrupt": _plan("raise KeyboardInterrupt"),
    "raises CancelledError": _plan("import asyncio; raise asyncio.CancelledError"),
    "raises MemoryError": _plan("raise MemoryError"),
    "exits": _plan("sys.exit(0)"),
    "exits at once": _plan("os._exit(0)"),
    "is killed": _plan("os.kill(os.getpid(), 9)"),
    "breaks the memory": _plan("import ctypes; ctypes.string_at(0)"),
    "hangs": _plan("time.sleep(3600)"),
    "hangs in reset": _class("def reset(self, scene): time.sleep(3600)"),
    "closes stdout": _plan("sys.stdout.close(); os.close(1); return Good.plan(self, observation)"),
    "closes stderr": _plan("os.close(2); return Good.plan(self, observation)"),
    "writes to stdout": _plan("os.write(1, b'{'); print('thinking'); return Good.plan(self, observation)"),
    "closes every file": _plan("os.closerange(3, 200); return Good.plan(self, observation)"),
    "forks": _plan("os.fork() or os._exit(0); return Good.plan(self, observation)"),
    "leaves threads": _plan(
        "threading.Thread(target=time.sleep, args=(60,)).start(); return Good.plan(self, observation)"
    ),
    "changes the folder": _plan("os.chdir('/'); return Good.plan(self, observation)"),
    "changes the environment": _plan("os.environ.clear(); return Good.plan(self, observation)"),
    "replaces open": _plan("import builtins; builtins.open = None; return Good.plan(self, observation)"),
    "changes numpy's errors": _plan("np.seterr(all='raise'); return Good.plan(self, observation)"),
    "turns warnings into errors": _plan(
        "import warnings; warnings.simplefilter('error'); return Good.plan(self, observation)"
    ),
    "limits recursion": _plan("sys.setrecursionlimit(60); return Good.plan(self, observation)"),
    "handles alarms": _plan("import signal; signal.alarm(1); time.sleep(2); return Good.plan(self, observation)"),
    "plans nothing": _plan("return None"),
    "plans an array": _plan("return np.zeros((6, 2))"),
    "plans NaN": _plan("return Plan(np.full((6, 2), np.nan), PlanFrame.EGO)"),
    "plans infinity": _plan("return Plan(np.full((6, 2), np.inf), PlanFrame.EGO)"),
    "plans 1e300 metres": _plan("return Plan(np.full((6, 2), 1e300), PlanFrame.EGO)"),
    "plans five steps": _plan("return Plan(np.zeros((5, 2)), PlanFrame.EGO)"),
    "plans a thousand steps": _plan("return Plan(np.zeros((1000, 2)), PlanFrame.EGO)"),
    "plans text": _plan("return Plan(np.full((6, 2), 'x'), PlanFrame.EGO)"),
    "plans objects": _plan("return Plan(np.full((6, 2), None), PlanFrame.EGO)"),
    "plans complex numbers": _plan("return Plan(np.zeros((6, 2), complex), PlanFrame.EGO)"),
    "plans in no frame": _plan("return Plan(np.zeros((6, 2)), 'north')"),
    "plans without memory": _plan("return Plan(np.broadcast_to(np.zeros(1), (6, 2)), PlanFrame.EGO)"),
    "changes what it is shown": _plan(
        "object.__setattr__(observation, 'index', 99); return Good.plan(self, observation)"
    ),
    "changes its plan afterwards": _plan(
        "self.kept = getattr(self, 'kept', np.zeros((6, 2))); self.kept += 1; return Plan(self.kept, PlanFrame.EGO)"
    ),
    "cannot be imported": "import no_such_package_at_all\n",
    "is no Python": "class Planner(\n",
    "raises when it is imported": "raise RuntimeError('not today')\n",
    "exits when it is imported": "import sys\nsys.exit(0)\n",
    "is empty": "",
    "is not UTF-8 by its own word": "# -*- coding: klingon -*-\nPlanner = 1\n",
    "has a metaclass that raises": (
        "class Meta(type):\n    def __call__(cls): raise RuntimeError('no instances')\n"
        "class Planner(metaclass=Meta):\n    pass\n"
    ),
}
"""Source of each by what is odd."""
