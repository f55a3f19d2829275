"""Where the processor time of one adversary goes: sampling, physics, scoring, the rest; the paper's beside it.

The paper's seconds are for one scene of about 240 frames.
"""

import argparse
import time

from benchmark.machine.pages import keep_pages
from benchmark.machine.workers import single_threaded
from benchmark.published import RUNTIME_S
from generation.diffusion.prior import TrajectoryPrior
from generation.search.adversary import Searched, attempts_together
from generation.search.eligibility import eligibility_of
from generation.search.hyperparameters import HyperParameters
from generation.sources.town import town_scene

STAGES = ("sampling", "physics", "scoring", "other")


def evaluations(result: Searched) -> int:
    """Batches that were simulated and scored; the trace of a vehicle's last search has one entry for each."""
    return sum(len(plan.best_scores) for plan in result.attempt.plans)


def report(result: Searched, processor_s: float, wall_s: float) -> None:
    """Stages of one attempt, each as a whole and for one evaluation."""
    attempt = result.attempt
    count = evaluations(result)
    print(
        f"{attempt.scene} {attempt.agent[:8]}: {attempt.discard or 'kept'}, {attempt.tries} tries, "
        f"{len(result.poses)} frames, {len(attempt.plans)} plans, {count} evaluations; {wall_s:.2f} s by the clock"
    )
    print(f"  {'':<10}{'s':>9}{'share':>9}{'ms an evaluation':>18}{'paper, s':>11}")
    for stage in STAGES:
        seconds, paper = result.stage_seconds[stage], RUNTIME_S.get(stage)
        line(stage, seconds, seconds / processor_s, count, paper)
    line("all", processor_s, 1.0, count, sum(RUNTIME_S.get(stage, 0.0) for stage in STAGES))


def line(stage: str, seconds: float, share: float, count: int, paper_s: float | None) -> None:
    each = f"{1e3 * seconds / count:.1f}" if count else "-"
    paper = "-" if paper_s is None else f"{paper_s:.2f}"
    print(f"  {stage:<10}{seconds:>9.2f}{share:>9.0%}{each:>18}{paper:>11}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=int, default=0, help="number of the town scene")
    parser.add_argument("--vehicles", type=int, default=2)
    parser.add_argument("--candidates", type=int, default=256)
    arguments = parser.parse_args()
    single_threaded()
    # As the workers of a search.
    keep_pages()
    # One try, so that the trace counts every evaluation that took time.
    hyper = HyperParameters(candidates=arguments.candidates, tries=1)
    prior, scene = TrajectoryPrior.load(), town_scene("val", arguments.scene)
    agents = [vehicle.agent for vehicle in eligibility_of(scene, hyper, 0).chosen][: arguments.vehicles]
    # The first use of everything pays for matrices that are kept.
    attempts_together([(scene, agents[0])], 0, HyperParameters(candidates=4, rounds=1, tries=1), prior)
    for agent in agents:
        processor, wall = time.process_time(), time.perf_counter()
        (result,) = attempts_together([(scene, agent)], 0, hyper, prior)
        report(result, time.process_time() - processor, time.perf_counter() - wall)


if __name__ == "__main__":
    main()
