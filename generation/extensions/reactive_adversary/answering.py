"""What others who answer will do: their own policy, run on for as long as scores look, from where all are now.

They are expected to answer an ego that does what is expected of it, and an adversary that goes on as it was planned.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmark.closed_loop.adversary import Handover
from benchmark.closed_loop.contract import AgentPolicy, Moment
from benchmark.closed_loop.following import INSTANTS, SUBSTEP_US
from benchmark.geometry import Floats, wrap_angle
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.allowed import AHEAD_FRAMES


@dataclass(frozen=True, slots=True)
class Answering:
    """All others, who answer what the adversary and the ego do.

    ``own`` are (F, 3) poses of the vehicle of the adversary, driven and expected, from the hand-over on.
    """

    policy: AgentPolicy[Any]
    memory: Any
    handover: Handover
    own: Floats


def with_expected_others(scene: Scene, others: Answering, moment: Moment, frame: int) -> Scene:
    """The scene, with the ego as it is expected, and all others where they will be, if they answer.

    Beyond what is looked at, its tracks are held.
    """
    times = scene.timestamps_us
    last = min(frame + AHEAD_FRAMES, len(times) - 1)
    steps = -(-int(times[last] - moment.time_us) // SUBSTEP_US)
    rows, boxes, present = _run_on(others, moment, scene, steps)
    agents = scene.agents
    position, yaw, valid = agents.position.copy(), agents.yaw.copy(), agents.valid.copy()
    later = np.flatnonzero(times >= moment.time_us)
    seconds, asked = (rows - rows[0]) / 1e6, np.clip((times[later] - rows[0]) / 1e6, 0.0, (rows[-1] - rows[0]) / 1e6)
    place = np.clip(np.searchsorted(seconds, asked, side="right") - 1, 0, len(rows) - 2)
    share = ((asked - seconds[place]) / (seconds[place + 1] - seconds[place]))[:, None]
    for agent in range(len(agents)):
        first, second = boxes[place, agent], boxes[place + 1, agent]
        position[agent, later, :2] = first[:, :2] + share * (second[:, :2] - first[:, :2])
        yaw[agent, later] = first[:, 4] + share[:, 0] * wrap_angle(second[:, 4] - first[:, 4])
        # Who is there at one end of a step may be in the way in all of it.
        valid[agent, later] = present[place, agent] | present[place + 1, agent]
    kept = others.handover.agent
    position[kept], yaw[kept], valid[kept] = agents.position[kept], agents.yaw[kept], agents.valid[kept]
    return replace(scene, agents=replace(agents, position=position, yaw=yaw, valid=valid))


def _run_on(others: Answering, moment: Moment, scene: Scene, steps: int) -> tuple[Floats, Floats, Floats]:
    """(R,) microseconds, (R, N, 5) boxes and (R, N) presence of all, beginning now."""
    times, boxes, present = [moment.time_us], [moment.boxes], [moment.present]
    ego = scene.ego.boxes
    frames = (scene.timestamps_us - moment.time_us) / 1e6
    yaw = np.unwrap(ego[:, 4])
    memory = others.memory
    for step in range(max(steps, 1)):
        memory, moved = others.policy.act(memory, moment, 0)
        moved = others.handover.moved(moved, others.own, moment.time_us)
        now_us = moment.time_us + SUBSTEP_US
        at = (step + 1) * SUBSTEP_US / 1e6
        box = np.array(
            [
                np.interp(at, frames, ego[:, 0]),
                np.interp(at, frames, ego[:, 1]),
                *ego[0, 2:4],
                np.interp(at, frames, yaw),
            ]
        )
        speed = float(np.hypot(*(box[:2] - moment.ego[:2]))) / (SUBSTEP_US / 1e6)
        moment = Moment(now_us, box, speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        times += [now_us - SUBSTEP_US + (row + 1) * SUBSTEP_US // INSTANTS for row in range(INSTANTS)]
        boxes += [*moved.boxes]
        present += [*moved.present]
    return np.array(times), np.stack(boxes), np.stack(present)
