"""Encounters with an adversary that is planned while a planner drives, without images: outcomes, touches, time.

    python bench/adversary_in_the_loop.py --data mini --split adv --out encounters.jsonl
    python bench/adversary_in_the_loop.py --data mini --split adv --agents replay --out encounters.jsonl
    python bench/adversary_in_the_loop.py --rounds 0 --candidates 32 --every 2 --out encounters.jsonl
    python bench/adversary_in_the_loop.py --runs 50 --no-careful --out touches.jsonl

Every encounter is a line of the file, written when it has ended: the same command goes on where it stopped. At the end
it prints how often the planner failed, at fault and attributably, how often the careful human survives, whom the
adversary touched, and the processor time of a replanning and of an encounter.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark
from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.closed_loop.driving import Drive, Stage, drive
from benchmark.closed_loop.ladder import climbed
from benchmark.closed_loop.scoring import score_drive
from benchmark.closed_loop.sensors import NoSensor
from benchmark.geometry import boxes_overlap
from benchmark.interactions.reaction import Driver
from benchmark.runs.redriving import can_of
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.making import InTheLoop
from generation.extensions.reactive_adversary.settings import AdversarySettings


def touched(scene: Scene, found: Drive) -> list[str]:
    """Who else than the ego was touched by the adversary, by identifier; every 0.1 s of the drive."""
    assert found.adversary is not None
    agent, motion = found.adversary.agent, found.motion
    begun = motion.times_us >= scene.timestamps_us[found.adversary.start]
    boxes = motion.boxes(scene.agents.size)
    others = [other for other in range(len(boxes)) if other != agent]
    both = motion.present[others] & motion.present[agent] & begun
    hit = both & boxes_overlap(boxes[others], boxes[agent][None])
    # Who overlaps it where it leaves its recording did so in the recording.
    fresh = hit.any(axis=1) & ~hit[:, np.argmax(begun)]
    return [scene.agents.ids[others[row]] for row in np.flatnonzero(fresh)]


def encounter(data: Any, name: str, run: int, rides: DefaultRides, planner: Any, *, careful: bool) -> dict[str, Any]:
    """One drive and the careful human in the same encounter."""
    scene = data.scene(name)
    begun = time.process_time()
    found = drive(Stage(scene, can_of(data, name), run, rides, NoSensor(), 600.0), planner)
    seconds = time.process_time() - begun
    contact = score_drive(scene, found).contact
    track = found.adversary
    row: dict[str, Any] = {
        "scene": name,
        "run": run,
        "contact": None
        if contact is None
        else [round(contact.seconds, 2), contact.kind, contact.adversary, contact.at_fault],
        "impact": None if contact is None else round(contact.impact_speed, 2),
        "seconds": round(seconds, 2),
        "driven_s": round(float(found.motion.seconds[-1]), 1),
    }
    if track is not None:
        row |= {
            "replanned": len(track.replanned),
            "braked": sum(each.braked for each in track.replanned),
            "touched": touched(scene, found),
            "agent": scene.agents.ids[track.agent],
        }
    if careful:
        (human,) = climbed(scene, rides.course(scene, run), [Driver.CC])
        row["careful"] = [human.survives, human.seconds, human.kind]
        row["careful_by"] = None if human.agent is None else scene.agents.ids[human.agent]
    return row


def said(rows: list[dict[str, Any]]) -> str:
    """What the rows of one world say together."""
    count = len(rows)
    fault = [bool(row["contact"] and row["contact"][3]) for row in rows]
    pursued = sum(blamed and row["contact"][2] for blamed, row in zip(fault, rows, strict=True))
    words = [f"{count} encounters", f"at fault {sum(fault)}, {pursued} of them with the adversary"]
    judged = [row for row in rows if "careful" in row]
    if judged:
        survives = [row["careful"][0] for row in judged]
        fair = [row["contact"][2] for row in judged if row["contact"] and row["contact"][3] and row["careful"][0]]
        words += [f"careful survives {sum(survives)} of {len(judged)}", f"attributable {sum(fair)}"]
        words.append(f"with bystanders {len(fair) - sum(fair)}")
    planned = [row for row in rows if row.get("replanned")]
    if planned:
        plans = sum(row["replanned"] for row in planned)
        spent = sum(row["seconds"] for row in planned)
        driven = sum(row["driven_s"] for row in planned)
        words += [
            f"{plans} replannings, {spent / plans:.3f} s each with all of the drive",
            f"{20 * spent / driven:.2f} s for 20 s of driving",
            f"braked {sum(row['braked'] for row in planned)}",
            f"touched somebody in {sum(bool(row['touched']) for row in planned)}",
        ]
    return ", ".join(words)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="mini")
    parser.add_argument("--split", default="adv")
    parser.add_argument("--model", default="constant-velocity-on-path")
    parser.add_argument("--agents", default="adversary", choices=("adversary", "replay", "idm"))
    parser.add_argument("--knows", default="motion")
    parser.add_argument("--others", default="replay")
    parser.add_argument("--every", type=float, default=1.0)
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--candidates", type=int)
    parser.add_argument("--first", type=int, default=0, help="first run")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--no-careful", action="store_true")
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    settings = AdversarySettings.of(
        knows=chosen.knows,
        every_s=chosen.every,
        others=chosen.others,
        rounds=chosen.rounds,
        candidates=chosen.candidates,
    )
    maker = InTheLoop.of(settings) if chosen.agents == "adversary" else None
    rides = DefaultRides(chosen.agents, 0, maker)
    world = {"data": chosen.data, "split": chosen.split, "model": chosen.model, "agents": chosen.agents}
    world |= {} if maker is None else dict(maker.facts)
    data = benchmark.open_split(benchmark.open_data(chosen.data), chosen.split)
    planner = benchmark.load_planner(chosen.model)()
    kept = [json.loads(line) for line in chosen.out.read_text().splitlines()] if chosen.out.exists() else []
    rows = {(row["scene"], row["run"]): row for world_of, row in kept if world_of == world}
    wanted = [
        (name, run)
        for run in range(chosen.first, chosen.first + (chosen.runs if maker else 1))
        for name in data.scene_names(chosen.split)
        if maker is None or maker.possible(data.scene(name))
    ]
    with chosen.out.open("a") as file:
        for name, run in wanted:
            if (name, run) not in rows:
                rows[name, run] = encounter(data, name, run, rides, planner, careful=not chosen.no_careful)
                file.write(json.dumps([world, rows[name, run]]) + "\n")
                file.flush()
    print(world)
    print(said([rows[each] for each in wanted]))


if __name__ == "__main__":
    main()
