"""`carla-driver-interface` as the other end, and planners over gRPC beside the same in this process."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adapters.planners.constant_velocity import ConstantVelocity
from benchmark import api
from benchmark.closed_loop.episodes import run_episode
from benchmark.extensions.alpasim.model import egodriver_planner
from benchmark.planning import Observation, Plan, Planner, SceneInfo
from generation.render.sensor import SchematicSensor
from tests.benchmark.extensions.alpasim.made import on_stage, serving


@pytest.mark.path
def test_constant_velocity_over_grpc_is_constant_velocity() -> None:
    with serving(ConstantVelocity) as server:
        over = run_episode(on_stage(8.0), egodriver_planner(server.url, image_format="png"))
    here = run_episode(on_stage(8.0), ConstantVelocity())
    assert over.failure is None and len(over.plans) == len(here.plans) == 15
    for one, other in zip(over.plans, here.plans):
        np.testing.assert_allclose(one.waypoints, other.waypoints, atol=1e-3)


def test_their_loop_drives_with_our_server() -> None:
    testing = pytest.importorskip("carla_driver_interface.testing")
    with serving(ConstantVelocity) as server:
        cameras = [testing.FakeCamera("CAM_FRONT", 80, 45)]
        with testing.FakeLoop(f"127.0.0.1:{server.port}", cameras, initial_speed_mps=5.0) as loop:
            found = loop.run(50)
    assert found.steps == 50 and not found.terminated_by_policy
    np.testing.assert_allclose(found.ego.positions[-1], [24.5, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize(("plan_hz", "seconds"), [(2, 26.0), (10, 6.0)])
def test_their_route_follower_drives_fifty_steps_of_ours(plan_hz: int, seconds: float) -> None:
    server = pytest.importorskip("carla_driver_interface.server")
    from carla_driver_interface.policies.route_follower import RouteFollowerPolicy

    with server.serving(RouteFollowerPolicy(), port=0, host="127.0.0.1", mode="alpasim") as port:
        planner = egodriver_planner(f"grpc://127.0.0.1:{port}")
        planner.require_alive()
        found = run_episode(on_stage(seconds, plan_hz=plan_hz), planner)
        planner.end_session()
    assert found.failure is None and found.end == "end"
    assert len(found.plans) + sum(map(len, found.between)) >= 50
    along = found.motion.ego[:, 0] - found.motion.ego[0, 0]
    # It follows the route, at the speed that it cruises at.
    assert along[-1] > 4.0 * (seconds - 1.0) and np.ptp(found.motion.ego[:, 1]) < 0.3


class _Recording:
    """A planner that keeps what it saw."""

    def __init__(self, planner: Planner) -> None:
        self.planner, self.name = planner, planner.name
        self.seen: list[tuple[Observation, Plan]] = []

    def reset(self, scene: SceneInfo) -> None:
        self.planner.reset(scene)

    def plan(self, observation: Observation) -> Plan:
        plan = self.planner.plan(observation)
        self.seen.append((observation, plan))
        return plan


def test_a_miniature_with_png_plans_as_in_this_process_given_the_same_motion_and_command() -> None:
    served, own = (_Recording(api.load_planner("vad-mini")()) for _ in range(2))
    stage = replace(on_stage(4.0), sensor=SchematicSensor(), most_plans=4)
    stage = replace(stage, scene=replace(stage.scene, cameras=tuple(c.resized(192, 108) for c in stage.scene.cameras)))
    with serving(lambda: served, wants_images=True) as server:
        over = run_episode(stage, egodriver_planner(server.url, image_format="png"))
    assert over.failure is None and len(served.seen) == 4

    class Given(_Recording):
        """Sees the pictures of this process with motion and command as the wire has them."""

        def plan(self, observation: Observation) -> Plan:
            told, _ = served.seen[len(self.seen)]
            same: dict[str, Any] = {name: getattr(told, name) for name in ("ego", "past_poses", "past_valid", "lidar")}
            for name, view in told.views.items():
                np.testing.assert_array_equal(view.load(), observation.views[name].load())
                np.testing.assert_allclose(view.camera.intrinsic, observation.views[name].camera.intrinsic, rtol=1e-6)
            ahead = replace(observation, **same, command=told.command, timestamp_us=told.timestamp_us)
            # Poses of cameras are in the frame of the motion.
            views = {
                name: replace(ahead.views[name], global_T_ego=told.views[name].global_T_ego) for name in ahead.views
            }
            return super().plan(replace(ahead, views=views))

    here = run_episode(stage, Given(own.planner))
    for one, other in zip(over.plans, here.plans):
        np.testing.assert_allclose(one.waypoints[:, :2], _in_rig(other), atol=2e-3)


def _in_rig(plan: Plan) -> Any:
    from benchmark.constants import LIDAR_FROM_REAR_AXLE_M
    from benchmark.pdm.plan_motion import plan_to_poses

    return plan_to_poses(plan, LIDAR_FROM_REAR_AXLE_M)[:, :2]
