"""Log likelihood of one cell of planner and scene, its gradients, and the information about the ability.

Notation: ability θ, discrimination α, difficulty β, t = α θ, logistic function σ. A binary cell is safe with
σ(α (θ - β)) (two-parameter model); an ordered one reaches category k with σ(t - c_k). A score is zero-one-inflated
Beta (Molenaar et al. 2022): 0 with σ(g0 - t), 1 with σ(t - g1), else Beta(A, B) with η = t - β, A = exp((η + o) / 2),
B = exp((o - η) / 2).
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from benchmark.geometry import Floats

CLIPPED: Final = 1e-6
"""Scores this near 0 or 1 that are not exactly so are taken for scores at this distance."""

_STEPS: Final = 8
_STIRLING: Final = (1 / 12, -1 / 360, 1 / 1260, -1 / 1680, 1 / 1188, -691 / 360360, 1 / 156)
"""Stirling's series in odd powers of 1 / x: at 8 it is exact to 1e-15."""


@dataclass(frozen=True, slots=True)
class Mathematics:
    """Array functions of a library, so that what is sampled is the likelihood whose cells are checked."""

    np: Any

    def log_sigmoid(self, x: Any) -> Any:
        """The log of σ(x), stable far out on both sides."""
        return self.np.minimum(x, 0.0) - self.np.log1p(self.np.exp(-self.np.abs(x)))

    def log_beta(self, a: Any, b: Any) -> Any:
        """The log of the Beta function of a, b > 0: Stirling's series of the gamma function, eight steps on.

        Four logs in all: sampling scores is mostly this.
        """
        (of_a, rise_a), (of_b, rise_b), (of_both, rise_both) = map(self._shift_gamma, (a, b, a + b))
        return of_a + of_b - of_both - self.np.log(rise_a / rise_both * rise_b)

    def _shift_gamma(self, x: Any) -> tuple[Any, Any]:
        """The log of Γ(x + 8), and Γ(x + 8) / Γ(x)."""
        rise, at, series = x, x + _STEPS, 0.0
        for step in range(1, _STEPS):
            rise = rise * (x + step)
        square = 1.0 / (at * at)
        for term in reversed(_STIRLING):
            series = series * square + term
        return (at - 0.5) * self.np.log(at) - at + 0.5 * np.log(2.0 * np.pi) + series / at, rise


NUMPY: Final = Mathematics(np)


class ScoreItem(NamedTuple):
    """Parameters of scores on a scene, arrays of any equal shapes.

    Attributes:
        beta: Difficulty of the Beta part, on the scale of t.
        omega: Log precision of the Beta part.
        g0: Cut between 0 and the Beta part.
        apart: Distance g1 - g0 of the cuts, above zero.
    """

    beta: Any
    omega: Any
    g0: Any
    apart: Any


def clip_scores(x: Floats) -> Floats:
    """Scores (any shape) that may be 0 or 1 exactly, or lie at least `CLIPPED` inside."""
    inside = np.clip(x, CLIPPED, 1.0 - CLIPPED)
    return np.where((x == 0.0) | (x == 1.0), x, inside)


def compute_binary_log_likelihood(x: Any, alpha: Any, ability: Any, beta: Any, use: Mathematics) -> Any:
    """Log of P(x): 1 is safe, 0 is not."""
    return use.log_sigmoid((2.0 * x - 1.0) * alpha * (ability - beta))


def compute_ordered_log_likelihood(x: Any, t: Any, cuts: Any, use: Mathematics) -> Any:
    """Log of P(x) of K ordered categories 0 .. K - 1, by rising cuts of shape (..., K - 1).

    A difference of two sigmoids is written as a product, which does not cancel.
    """
    below = x == 0
    above = x == cuts.shape[-1]
    at = use.np.clip(x, 1, cuts.shape[-1]).astype(int)[..., None]
    low = use.np.take_along_axis(cuts, at - 1, -1)[..., 0]
    high = use.np.take_along_axis(cuts, use.np.minimum(at, cuts.shape[-1] - 1), -1)[..., 0]
    inside = ~(below | above)
    gap = use.np.where(inside, high - low, 1.0)
    reached = use.log_sigmoid(t - low)
    between = reached + use.log_sigmoid(high - t) + use.np.log1p(-use.np.exp(-gap))
    return use.np.where(below, use.log_sigmoid(low - t), use.np.where(above, reached, between))


def compute_score_log_likelihood(x: Any, t: Any, item: ScoreItem, use: Mathematics) -> Any:
    """Log density of a score as `clip_scores` leaves it; at 0 and 1 the log of their probability."""
    upper = item.g0 + item.apart
    shapes = _beta_shapes(t, item, use)
    inner = use.np.where((x == 0.0) | (x == 1.0), 0.5, x)
    density = (shapes[0] - 1.0) * use.np.log(inner) + (shapes[1] - 1.0) * use.np.log1p(-inner)
    above, below = use.log_sigmoid(t - item.g0), use.log_sigmoid(upper - t)
    between = above + below + use.np.log1p(-use.np.exp(-item.apart))
    inside = between + density - use.log_beta(*shapes)
    # The log of σ(-z) is that of σ(z), less z.
    ends = use.np.where(x == 0.0, above - (t - item.g0), below - (upper - t))
    return use.np.where((x == 0.0) | (x == 1.0), ends, inside)


def _beta_shapes(t: Any, item: ScoreItem, use: Mathematics) -> tuple[Any, Any]:
    eta = t - item.beta
    return use.np.exp((eta + item.omega) / 2.0), use.np.exp((item.omega - eta) / 2.0)


class ScoreGradients(NamedTuple):
    """Derivatives of the log likelihood by t and the four parameters of `ScoreItem`; g1 moves with g0."""

    t: Floats
    beta: Floats
    omega: Floats
    g0: Floats
    apart: Floats


def compute_score_gradients(x: Floats, t: Floats, item: ScoreItem) -> ScoreGradients:
    """Gradients of `compute_score_log_likelihood` in closed form, of the shape of ``x``."""
    from scipy.special import digamma
    from scipy.special import expit as sigmoid

    lower, upper = sigmoid(t - item.g0), sigmoid(item.g0 + item.apart - t)
    a, b = _beta_shapes(t, item, NUMPY)
    inner = np.where((x == 0.0) | (x == 1.0), 0.5, x)
    by_a = a * (np.log(inner) - digamma(a) + digamma(a + b))
    by_b = b * (np.log1p(-inner) - digamma(b) + digamma(a + b))
    by_eta = (by_a - by_b) / 2.0
    shrink = np.exp(-item.apart) / -np.expm1(-item.apart)
    zero, one = x == 0.0, x == 1.0

    def choose(at_zero: Any, at_one: Any, between: Any) -> Floats:
        return np.where(zero, at_zero, np.where(one, at_one, between))

    return ScoreGradients(
        t=choose(-lower, upper, (1.0 - lower) - (1.0 - upper) + by_eta),
        beta=choose(0.0, 0.0, -by_eta),
        omega=choose(0.0, 0.0, (by_a + by_b) / 2.0),
        g0=choose(lower, -upper, -(1.0 - lower) + (1.0 - upper)),
        apart=choose(0.0, -upper, (1.0 - upper) + shrink),
    )


def compute_binary_information(alpha: Floats, ability: Floats, beta: Floats) -> Floats:
    """Fisher information about the ability: α² P (1 - P)."""
    from scipy.special import expit

    safe = expit(alpha * (ability - beta))
    return np.asarray(alpha**2 * safe * (1.0 - safe))


def compute_score_information(t: Floats, item: ScoreItem) -> Floats:
    """Fisher information of a score about t; times α² it is about the ability.

    Of the three masses Σ P'² / P, and what the Beta part adds where the score is between.
    """
    from scipy import special

    lower, upper = special.expit(t - item.g0), special.expit(t - item.g0 - item.apart)
    slope_lower, slope_upper = lower * (1.0 - lower), upper * (1.0 - upper)
    between = lower * (1.0 - upper) * -np.expm1(-item.apart)
    a, b = _beta_shapes(t, item, NUMPY)
    trigamma = special.polygamma
    of_beta = (a**2 * trigamma(1, a) + b**2 * trigamma(1, b) - (a - b) ** 2 * trigamma(1, a + b)) / 4.0
    # P'^2 / P at the ends, without the quotient: P' = P (1 - P).
    ends = slope_lower * lower + slope_upper * (1.0 - upper)
    middle = (slope_lower - slope_upper) ** 2 / np.maximum(between, np.finfo(float).tiny)
    return np.asarray(ends + middle + between * of_beta)


def compute_expected_score(t: Floats, item: ScoreItem) -> Floats:
    """Mean of the score's distribution."""
    from scipy import special

    lower, upper = special.expit(t - item.g0), special.expit(t - item.g0 - item.apart)
    return np.asarray(upper + (lower - upper) * special.expit(t - item.beta))
