"""Vehicles behind the ego that keep their distance once an ego that was slowed down is in their way."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot
from benchmark.closed_loop.idm_policy import IdmMemory, IdmPolicy, find_leaders
from benchmark.closed_loop.simulation_config import build_log_replay
from benchmark.constants import FOUR_WHEELED_CATEGORIES, FRAME_HZ
from benchmark.geometry import wrap_angle
from benchmark.interactions.driver_simulation import DrivingSituation
from benchmark.interactions.idm_driver import compute_idm_acceleration
from benchmark.scene import Scene

BEHIND_M: Final = 60.0
ASIDE_M: Final = 1.5
ALIGNED_RAD: Final = np.pi / 4
LEAST_S: Final = 1.0
"""A follower is so near behind the recorded ego on its path, heading as it does, for so long."""
BRAKING_M_S2: Final = 2.0
"""Who would have to brake harder than this for what is ahead leaves its recording."""
_REPLAYED: Final = "movable_object.debris"


@dataclass(frozen=True, slots=True)
class FollowerPolicy(IdmPolicy):
    """All as recorded, but followers keep distance from the moment on at which something off the record holds them up.

    From then on each is driven as by `IdmPolicy`.
    """

    @classmethod
    def behind(cls, scene: Scene, situation: DrivingSituation, adversary: int | None) -> "FollowerPolicy":
        """The policy of a scene; an adversary follows nobody."""
        following = find_followers(scene, situation)
        names = [
            name if following[agent] and agent != adversary else _REPLAYED
            for agent, name in enumerate(scene.agents.categories)
        ]
        first, last = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1])
        made = cls.of(build_log_replay(scene, first, last), names, scene.road_map)
        assert isinstance(made, cls)
        return made

    def act(self, memory: IdmMemory, moment: TrafficSnapshot, key: int) -> tuple[IdmMemory, AgentMotion]:
        """The next 0.1 s."""
        _, recorded = self.replay.act(None, moment, key)
        if not len(self.driving):
            return memory, recorded
        # Called by name: a class with slots is made twice, and `super` knows the first one.
        memory, moved = IdmPolicy.act(self, self._hand_over(memory, moment), moment, key)
        waiting = self.driving[~memory.come]
        moved.present[:, waiting] = recorded.present[:, waiting]
        return memory, moved

    def _hand_over(self, memory: IdmMemory, moment: TrafficSnapshot) -> IdmMemory:
        waiting = np.flatnonzero(moment.present[self.driving] & ~memory.come)
        if not len(waiting):
            return memory
        station, speed = memory.station.copy(), memory.speed.copy()
        for index in waiting.tolist():
            agent = self.driving[index]
            station[index] = max(float(self.roads.paths[index].project(moment.boxes[agent, :2])[0]), 0.0)
            speed[index] = np.hypot(*moment.velocity[agent])
        gap, leader_speed = find_leaders(self.roads, self.driving, station, waiting, moment)
        wanted = compute_idm_acceleration(speed, self.free_speed, gap, leader_speed)
        new = np.zeros(len(self.driving), np.bool_)
        new[waiting] = (wanted < -BRAKING_M_S2)[waiting]
        return replace(
            memory,
            station=np.where(new, station, memory.station),
            speed=np.where(new, speed, memory.speed),
            here=memory.here | new,
            come=memory.come | new,
        )

    def _add_arrivals(self, memory: IdmMemory, moved: AgentMotion) -> IdmMemory:
        """Nobody drives by itself because it has appeared."""
        return memory


def find_followers(scene: Scene, situation: DrivingSituation) -> list[bool]:
    """Whether each agent of a scene drives behind the recorded ego for a while."""
    ego = situation.path.recorded_station(scene.seconds)
    found = []
    for agent, category in enumerate(scene.agents.categories):
        there = np.flatnonzero(scene.agents.valid[agent])
        if category not in FOUR_WHEELED_CATEGORIES or not len(there):
            found.append(False)
            continue
        station, aside = situation.path.project(scene.agents.position[agent, there, :2])
        behind = ego[there] - station
        turn = wrap_angle(scene.agents.yaw[agent, there] - situation.path.heading(station))
        on = (behind > 0.0) & (behind < BEHIND_M) & (np.abs(aside) < ASIDE_M) & (np.abs(turn) < ALIGNED_RAD)
        found.append(bool(on.sum() >= LEAST_S * FRAME_HZ))
    return found
