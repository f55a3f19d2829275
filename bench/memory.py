"""How much memory a worker needs (resident set, MB), phase by phase, in the densest scene at hand."""

import argparse
import pickle
import resource
import time
from pathlib import Path

from benchmark.scene import Scene

MOST_MB = 1500.0
"""What a worker may need whatever the scene."""
RECORDED = Path(__file__).resolve().parents[2] / "shared" / "data" / "scenes"


def most_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def report(phase: str, started_s: float) -> None:
    spent_s = time.process_time() - started_s
    print(f"  {phase:<36}{resident_mb():8.0f} MB now {most_mb():8.0f} MB at most {spent_s:8.2f} s of processor time")


def densest_scene(town_scenes: int) -> Scene:
    """The scene with most objects: of the recordings beside the repository, or else of the town."""
    from benchmark.datasets.scenarionet import find_scenarionet, read_scenarionet
    from generation.sources.town import town_scene

    if RECORDED.is_dir():
        scenes = (read_scenarionet(path) for path in find_scenarionet(RECORDED))
    else:
        scenes = (town_scene("val", index) for index in range(town_scenes))
    return max(scenes, key=lambda scene: len(scene.agents))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--attempts", type=int, default=4, help="one after the other, as a worker makes them")
    parser.add_argument("--candidates", type=int, default=256)
    parser.add_argument("--town-scenes", type=int, default=8, help="to choose from where there are no recordings")
    arguments = parser.parse_args()
    started_s = time.process_time()
    from benchmark.machine.workers import single_threaded
    from generation.diffusion.prior import TrajectoryPrior
    from generation.search.adversary import attempts_together
    from generation.search.eligibility import eligibility_of
    from generation.search.hyperparameters import HyperParameters

    single_threaded()
    report("imports", started_s)
    started_s = time.process_time()
    prior = TrajectoryPrior.load()
    report("prior", started_s)
    started_s = time.process_time()
    scene = densest_scene(arguments.town_scenes)
    shipped = pickle.dumps(scene)
    report(f"{scene.name}, {len(scene.agents)} objects, {len(shipped) / 1e6:.1f} MB", started_s)
    hyper = HyperParameters(candidates=arguments.candidates)
    agents = [vehicle.agent for vehicle in eligibility_of(scene, hyper, 0).chosen]
    units = [(seed, agent) for seed in range(arguments.attempts) for agent in agents]
    for seed, agent in units[: arguments.attempts]:
        started_s = time.process_time()
        # As a worker gets it: each unit comes with its own copy.
        (result,) = attempts_together([(pickle.loads(shipped), agent)], seed, hyper, prior)  # noqa: S301
        outcome = result.attempt.discard or "kept"
        report(f"vehicle {agent}, seed {seed}: {outcome}", started_s)
    verdict = "within" if most_mb() <= MOST_MB else "PAST"
    print(f"{most_mb():.0f} MB at most, {verdict} the {MOST_MB:.0f} MB that a worker may need")


if __name__ == "__main__":
    main()
