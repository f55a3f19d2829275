"""The parts of the training of UniAD-mini: what ``challenger-bench train planner`` runs for it."""

from functools import partial

from adapters.extensions.training.phases import Phase
from adapters.extensions.training.trainer import Recipe
from adapters.extensions.training.uniad.heads_objective import HeadsObjective
from adapters.extensions.training.uniad.objective import UniADObjective
from adapters.extensions.training.uniad.planner_objective import PlannerObjective


def phases() -> tuple[Phase, ...]:
    """The parts of the training of UniAD-mini."""
    # What it sees is seen already (`seen_by_vad`): first what follows from it is learned, then everything together.
    heads = Recipe(steps=3000, learning_rate=1e-3, warmup=100, average=0.998, clips=6, check_every=1000)
    clips = Recipe(steps=3000, learning_rate=4e-4, encoder_rate=0.3, warmup=100, average=0.998)
    planner = Recipe(steps=4000, learning_rate=6e-4, warmup=100, average=0.998, clips=24, check_every=1000)
    return (
        Phase("heads", partial(HeadsObjective, clip_frames=4), heads),
        Phase("clips", partial(UniADObjective, clip_frames=4, learned_frames=2), clips),
        Phase("planner", PlannerObjective, planner),
    )
