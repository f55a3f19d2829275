"""Where the time of one adversary goes: diffusion, physics, scoring, the rest."""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmark.workers import single_threaded
from generation import adversary, refine
from generation.candidates import choose
from generation.diffusion.prior import TrajectoryPrior
from generation.hyperparameters import HyperParameters
from generation.town import town_scene


class Stopwatch:
    """Adds up the processor time of wrapped functions; the machine may be busy with other work."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.calls: dict[str, int] = {}

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, with its time added under a name."""

        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            start = time.process_time()
            try:
                return function(*arguments, **keywords)
            finally:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - start
                self.calls[name] = self.calls.get(name, 0) + 1

        return wrapper


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=int, default=0, help="number of the town scene")
    parser.add_argument("--vehicles", type=int, default=2)
    parser.add_argument("--candidates", type=int, default=256)
    arguments = parser.parse_args()
    single_threaded()
    hyper = HyperParameters(candidates=arguments.candidates)
    prior = TrajectoryPrior.load()
    scene = town_scene("val", arguments.scene)
    watch = Stopwatch()
    prior.sample = watch.timed("initial samples", prior.sample)  # type: ignore[method-assign]
    prior.mutate = watch.timed("mutations", prior.mutate)  # type: ignore[method-assign]
    for name in ("simulate", "score_terms", "verify", "_raster"):
        setattr(adversary, name, watch.timed(name.strip("_"), getattr(adversary, name)))
    refine.resample = watch.timed("resample", refine.resample)
    for agent in choose(scene, hyper, 0)[: arguments.vehicles]:
        watch.seconds.clear()
        watch.calls.clear()
        start, wall = time.process_time(), time.perf_counter()
        result = adversary.attempt(scene, agent, 0, hyper, prior)
        total, wall = time.process_time() - start, time.perf_counter() - wall
        outcome = "kept" if result.kept else result.discard
        print(f"{scene.name} vehicle {agent}: {outcome}, {len(result.poses)} frames, {len(result.plans)} plans")
        print(f"  {'all':<16}{total:8.2f} s of processor time ({wall:.2f} s by the clock)")
        for name, seconds in sorted(watch.seconds.items(), key=lambda item: -item[1]):
            calls = watch.calls[name]
            print(f"  {name:<16}{seconds:8.2f} s in {calls:4d} calls, {1e3 * seconds / calls:7.1f} ms each")
        rest = total - float(np.sum(list(watch.seconds.values())))
        print(f"  {'the rest':<16}{rest:8.2f} s")


if __name__ == "__main__":
    main()
