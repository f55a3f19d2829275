"""The planner of SparseDrive (Sun et al., 2024): plans are read from tokens of modes."""

from torch import Tensor

from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.motion_planner import Planner, PlannerPredictions, Scene, interaction_layers


class RegressionPlanner(Planner):
    """One plan for each mode and driving command, in one go."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__(config, {"layers": interaction_layers(config, plans=True)})

    def forward(self, scene: Scene, noise: Tensor | None = None) -> PlannerPredictions:
        """Forecasts and plans of a key frame; only the other planner has noise."""
        queue = self.instance_queue(scene.past, scene.motion, scene.agents, scene.ids, scene.front)
        found = self.interact(scene, queue)
        ego, front = self.with_front(found.tokens[-1:], scene.finest_front, scene.front_before)
        queries = self.plan_queries(ego)
        motion_logits, motion_offsets = self.forecast(scene.agents, found.tokens[:-1])
        status = self.refinement.plan_status_branch(ego)[0].float()
        return PlannerPredictions(
            motion_logits,
            motion_offsets,
            self.refinement.plan_cls_branch(queries)[..., 0].float(),
            self.refinement.plan_reg_branch(queries).float().unflatten(-1, (-1, 2)),
            status,
            queue,
            self.remember(scene, queue, found.features[-1:], status, front),
            {},
            front,
        )
