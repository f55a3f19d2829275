"""The joint fit of all planners and scenes: numpyro's NUTS in double precision, until its chains agree.

The model and its priors (docs/extensions/ability.md): p = θ_s + u_{s, r} with θ ~ N(0, 1), u ~ N(0, sd_u), log α ~
N(m_α, sd_α), β = m_β + ρ_r + N(0, sd_β), ρ ~ N(0, sd_ρ). u and ρ are in it only where a recording has two scenes.
Everything is sampled as standard normal variables and logs of deviations.
"""

import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.extension import require_package
from leaderboard.extensions.ability.likelihood import (
    NUMPY,
    Mathematics,
    ScoreItem,
    clip_scores,
    compute_binary_log_likelihood,
    compute_ordered_log_likelihood,
    compute_score_log_likelihood,
)
from leaderboard.extensions.ability.matrix import OutcomeMatrix
from leaderboard.extensions.ability.posterior import Posterior

CHAINS: Final = 4
WARM_UP: Final = 500
BLOCK: Final = 100
"""Draws between two looks at the clock."""
LEAST: Final = 1000
"""Draws of each chain before its first comparison with the others."""
MOST_R_HAT: Final = 1.01
_DEPTHS: Final = (6, 10)
"""Doublings of a trajectory at most, in the warm-up, where early steps are far too small, and after it."""
_NEAR: Final = 0.3
"""Chains start so near to 0: those of numpyro's default start do not find together."""
_HALF_NORMAL: Final = {
    "alpha": 0.5,
    "beta": 1.5,
    "rho": 1.0,
    "u": 0.5,
    "omega": 1.0,
    "g0": 1.0,
    "apart": 0.5,
    "step": 0.5,
}
"""Scales of the priors of deviations, half normal."""
_MEANS: Final = {
    "alpha": (0.5, 0.5),
    "beta": (0.0, 1.5),
    "omega": (1.5, 1.5),
    "g0": (-2.0, 1.5),
    "apart": (1.0, 1.5),
    "step": (0.0, 1.5),
}
"""Mean and deviation of the normal priors of means."""
Parameters = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class JointModel:
    """The model of one matrix: which variables there are, and how they make its parameters."""

    matrix: OutcomeMatrix
    steps: int

    @classmethod
    def of(cls, matrix: OutcomeMatrix) -> "JointModel":
        """The model of a matrix."""
        steps = int(np.nanmax(matrix.values)) - 1 if matrix.outcome == "ordered" else 0
        return cls(matrix, max(steps, 0))

    @property
    def of_items(self) -> dict[str, tuple[int, ...]]:
        """Parameters that each scene has, with their shapes."""
        scenes = len(self.matrix.scenes)
        names = ["alpha", "beta", *(("omega", "g0", "apart") if self.matrix.outcome == "score" else ())]
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(names, (scenes,))
        return shapes | ({"step": (scenes, self.steps)} if self.steps else {})

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each variable."""
        items = self.of_items
        shapes: dict[str, tuple[int, ...]] = {"theta": (len(self.matrix.planners),)}
        shapes |= {f"mean {name}": () for name in items} | {f"log sd {name}": () for name in items} | items
        if self.matrix.shares_recordings:
            recordings = len(self.matrix.places[0])
            shapes |= {"log sd rho": (), "rho": (recordings,)}
            shapes |= {"log sd u": (), "u": (len(self.matrix.planners), recordings)}
        return shapes

    def split(self, variables: Any) -> dict[str, Any]:
        """Variables by name, of (..., V) in one row."""
        parts, at = {}, 0
        for name, shape in self.shapes.items():
            size = int(np.prod(shape))
            parts[name] = variables[..., at : at + size].reshape((*variables.shape[:-1], *shape))
            at += size
        return parts

    def build(self, variables: Any, use: Mathematics) -> dict[str, Any]:
        """Parameters from (..., V) variables, with the same leading axes."""
        z = self.split(variables)
        built = {"theta": z["theta"]}
        for name, shape in self.of_items.items():
            mean, deviation = _MEANS[name]
            lead = (..., *(None for _ in shape))
            centre, spread = mean + deviation * z[f"mean {name}"], use.np.exp(z[f"log sd {name}"])
            built[name] = centre[lead] + spread[lead] * z[name]
        if self.matrix.shares_recordings:
            of_scene = self.matrix.places[1]
            built["rho"] = use.np.exp(z["log sd rho"])[..., None] * z["rho"]
            built["beta"] = built["beta"] + built["rho"][..., of_scene]
            built["sd_u"] = use.np.exp(z["log sd u"])
            built["u"] = built["sd_u"][..., None, None] * z["u"]
        # What is sampled of these is their log.
        built["log_alpha"] = built.pop("alpha")
        for name in ("apart", "step"):
            if name in built:
                built[name] = use.np.exp(built[name])
        return built

    @property
    def outcomes(self) -> Floats:
        """(S, N) outcomes as the likelihood wants them, 0 where there is none."""
        values = np.nan_to_num(self.matrix.values)
        return clip_scores(values) if self.matrix.outcome == "score" else values

    def make_potential(self, use: Mathematics, x: Any) -> Callable[[Any], Any]:
        """Negative log density of the variables given (S, N) outcomes, up to a constant."""
        known = self.matrix.known
        of_scene = self.matrix.places[1]

        # Of each variable whether it is a log of a deviation, and the scale of that one's prior.
        scales = [
            np.full(
                int(np.prod(shape)), _HALF_NORMAL.get(name.removeprefix("log sd "), 0.0) * name.startswith("log sd ")
            )
            for name, shape in self.shapes.items()
        ]
        scale = np.concatenate(scales)
        is_log, scale = scale > 0.0, np.where(scale > 0.0, scale, 1.0)

        def potential(variables: Any) -> Any:
            of_log = variables - 0.5 * (use.np.exp(use.np.where(is_log, variables, 0.0)) / scale) ** 2
            prior = use.np.where(is_log, of_log, -0.5 * variables**2).sum()
            built = self.build(variables, use)
            ability = built["theta"][:, None]
            if "u" in built:
                ability = ability + built["u"][:, of_scene]
            cells = _compute_cells(self.matrix.outcome, x, ability, built, use)
            return -(prior + use.np.where(known, cells, 0.0).sum())

        return potential


def _compute_cells(outcome: str, x: Floats, ability: Any, built: Parameters, use: Mathematics) -> Any:
    """(S, N) log likelihoods."""
    alpha = use.np.exp(built["log_alpha"])
    if outcome == "contact":
        return compute_binary_log_likelihood(x, alpha, ability, built["beta"], use)
    if outcome == "score":
        item = ScoreItem(*(built[name] for name in ScoreItem._fields))
        return compute_score_log_likelihood(x, alpha * ability, item, use)
    first = built["beta"][:, None]
    rise = use.np.cumsum(built["step"], axis=-1) if "step" in built else use.np.zeros((len(x[0]), 0))
    cuts = use.np.concatenate([first, first + rise], axis=-1)
    shape = (*x.shape, cuts.shape[-1])
    return compute_ordered_log_likelihood(x, alpha * ability, use.np.broadcast_to(cuts, shape), use)


@dataclass(frozen=True, slots=True)
class CompiledChains:
    """What samples one shape of matrix: compiled when it is first called, for any outcomes of that shape.

    Chains run one after the other: side by side, each would take the steps of the longest.

    Attributes:
        begin: From (C, V) variables, C keys and (S, N) outcomes the state of C chains.
        advance: From a state and the outcomes the next one, (C, block, V) variables, and (C, block) whether each draw
            diverged.
    """

    begin: Callable[[Any, Any, Floats], Any]
    advance: Callable[[Any, Floats], tuple[Any, Any, Any]]

    @classmethod
    def of(cls, model: JointModel) -> "CompiledChains":
        """Chains of a model."""
        import jax
        from numpyro.infer.hmc import hmc

        use = Mathematics(jax.numpy)
        start, sample = hmc(potential_fn_gen=lambda x: model.make_potential(use, x), algo="NUTS")

        def begin(variables: Any, keys: Any, x: Any) -> Any:
            def one(given: tuple[Any, Any]) -> Any:
                variables, key = given
                return start(variables, num_warmup=WARM_UP, max_tree_depth=_DEPTHS, model_args=(x,), rng_key=key)

            return jax.lax.map(one, (variables, keys))

        def advance(states: Any, x: Any) -> tuple[Any, Any, Any]:
            def step(state: Any, _: None) -> tuple[Any, tuple[Any, Any]]:
                state = sample(state, (x,), {})
                return state, (state.z, state.diverging)

            states, kept = jax.lax.map(lambda state: jax.lax.scan(step, state, None, length=BLOCK), states)
            return states, *kept

        return cls(jax.jit(begin), jax.jit(advance))

    def start(self, model: JointModel, seed: int) -> Any:
        """The state of four chains near 0."""
        import jax

        size = sum(int(np.prod(shape)) for shape in model.shapes.values())
        first = np.random.default_rng(seed).uniform(-_NEAR, _NEAR, (CHAINS, size))
        return self.begin(first, jax.random.split(jax.random.PRNGKey(seed), CHAINS), model.outcomes)


def fit_posterior(
    matrix: OutcomeMatrix,
    *,
    seed: int = 0,
    max_seconds: float = 600.0,
    least_draws: int = LEAST,
    compiled: CompiledChains | None = None,
) -> Posterior:
    """Draw from the joint posterior of all planners and scenes.

    Args:
        matrix: What happened; `OutcomeMatrix.require_enough` is the caller's.
        seed: The same seed and matrix give the same draws on one kind of processor.
        max_seconds: Seconds of processor time after which it gives up.
        least_draws: Draws of each of the four chains, at least.
        compiled: Chains that sampled another matrix with the same holes and recordings.

    Returns:
        Draws of chains that agree: R-hat of every ability, discrimination and difficulty is at most 1.01.

    Raises:
        InputError: If the chains did not agree in time, or numpyro is not installed.
    """
    require_package(
        "numpyro", 'abilities need numpyro; install it with: pip install "challenger-bench[ability]", or read ranks'
    )
    started, model = time.process_time(), JointModel.of(matrix)
    # One thread: the same sums in the same order, and no more processors than one.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax

    with ExitStack() as stack:
        stack.enter_context(jax.experimental.enable_x64())
        stack.enter_context(jax.default_device(jax.devices("cpu")[0]))
        chains = compiled or CompiledChains.of(model)
        x, state = model.outcomes, chains.start(model, seed)
        warm = -(-WARM_UP // BLOCK)
        blocks: list[dict[str, Floats]] = []
        drawn, worst = 0, np.inf
        while worst > MOST_R_HAT:
            if time.process_time() - started > max_seconds:
                so_far = f"R-hat {worst:.3f} after {drawn:,} draws" if np.isfinite(worst) else f"{drawn:,} draws"
                raise InputError(
                    f"the chains did not agree within {max_seconds:g} s of processor time ({so_far}, {MOST_R_HAT} is "
                    "needed): no number is given; raise --max-seconds"
                )
            state, variables, diverged = chains.advance(state, x)
            if warm:
                warm -= 1
                continue
            block = {name: np.asarray(values) for name, values in model.build(variables, NUMPY).items()}
            blocks.append({**block, "diverged": np.asarray(diverged)})
            drawn += BLOCK
            if drawn >= least_draws and drawn % (5 * BLOCK) == 0:
                worst = max(compute_r_hat(_join(blocks, name)) for name in ("theta", "log_alpha", "beta"))
    draws = {name: _join(blocks, name) for name in blocks[0]}
    diverged_draws = int(draws.pop("diverged").sum())
    return Posterior(matrix, draws, r_hat=float(worst), divergent=diverged_draws, seed=seed)


def _join(blocks: list[dict[str, Floats]], name: str) -> Floats:
    """(chains, draws, ...) of one parameter."""
    return np.concatenate([block[name] for block in blocks], axis=1)


def compute_r_hat(draws: Floats) -> float:
    """Largest split R-hat (Gelman et al. 2013) of (chains, draws, ...) parameters."""
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, half : 2 * half]]).reshape(2 * len(draws), half, -1)
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    between = halves.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt((half - 1) / half + between / within)
    return float(np.max(np.nan_to_num(ratio, nan=np.inf)))
