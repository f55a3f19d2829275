"""The measured part of the model card: every number comes from `evaluation` and its neighbours."""

from collections.abc import Sequence

from bench.denoiser_card.evaluation import TEST_DRAWS, TEST_REPEATS, TEST_SIZES, Report
from bench.denoiser_card.feasibility import HORIZONS_S, LIMITED_M, WITHIN_M
from bench.denoiser_card.sampling_steps import FULL_SAMPLES, FullProcess, StrideError
from bench.denoiser_card.two_sample import FEATURES, PERMUTATIONS
from generation.diffusion.prior import SOLVER_CALLS, SamplerSettings
from generation.extensions.denoiser_training.card import table

COMPARISON = """\
## Against driving it never saw

{windows:,} windows of {titles}. For the start of each
window a sample is drawn as a search draws it ({calls} network calls, told how the vehicle moves there), again if no car
could drive it from that speed. Distances are 1-Wasserstein. *Replay* draws training windows instead of samples: what an
unconditional model that knows its training data perfectly would reach.

{distances}

Root mean square error of the accelerations that the network finds in held-out windows with noise on them:

{errors}

- Drivable from a held-out start as drawn: {drivable_raw:.1%}; after drawing again: {drivable:.1%}.
- Nearest training window, median, root mean square: {nearest_sample:.2f} m/s^2 from a sample,
  {nearest_held_out:.2f} m/s^2 from a held-out window: samples are {copies}.
"""

TRACKING = """\
## Can a car follow them?

The physics simulator (limits of a driver, 12 Hz) drives along one sample from each of {starts} held-out starts, and
along the real window that began there. Share that passed every waypoint up to a time within a distance of it.

{shares}

The last column: share that a driver without limits would have driven more than {limited:g} m differently. Being late
counts as an error, so real driving is the yardstick, not 100 %.
"""

TWO_SAMPLE = """\
## Two-sample test

Energy distance of {features} features of each trajectory (speeds after 2, 4 and 8 s; mean and spread of acceleration
and lateral acceleration; spread of the change of acceleration and of the yaw rate; turn), in spreads of held-out
driving, with {relabellings} relabellings. One window of each of {vehicles} held-out vehicles: some stand for held-out
driving, what is tested starts where as many others did, and is drawn {draws} times (means are given). The last columns:
share of {repeats} tests with samples of that size that told the two apart at 5 %.

{rates}

{samples_apart}
{replay_apart}
A model of other roads cannot pass at every size: it does not know what the road ahead of this car is like. *Replay*
(of training windows) shows how much of that is the data's doing; *replay of held-out* puts held-out windows at the
starts of others and is the floor of every model that is not told how the vehicle moves; *held-out* shows that the test
keeps its 5 %.
"""

FULL = """\
## Fewer network calls in full processes

{samples:,} held-out starts, one sample each. Distances: mean over the quantities above, in spreads of held-out driving.
*Off*: root mean square distance of waypoints from the solver's finest solution with the same starting noise.

{costs}

Default: {calls} calls of the solver.
"""

BESIDE = """\
## Beside another model

Measured in the same run, with the same starts and draws: {which}.

{rows}
"""

TRUNCATED = """\
## Fewer network calls in the truncated processes

The five rounds of refinement on a diversified batch at 8 m/s; root mean square difference of waypoints from the
reference's process (one call per noise level) with the same noise, beside what two draws of that process differ by.

{strides}

Default: {default}.
"""


def comparison_sections(report: Report, titles: Sequence[str]) -> list[str]:
    """Sections on distances, tracking and the two-sample test.

    Args:
        report: From `compare_with_held_out`.
        titles: Of the held-out data sets.

    Returns:
        Markdown, section by section.
    """
    return [_comparison(report, titles), _tracking(report), _two_sample(report)]


def _comparison(report: Report, titles: Sequence[str]) -> str:
    head = ("quantity", "spread of held-out", "samples to held-out", "replay to held-out", "samples to replay")
    values = [
        (row.quantity, *(f"{value:.3f}" for value in (row.held_out_spread, row.model, row.replay, row.learnt)))
        for row in report.comparisons
    ]
    errors = report.denoising_error
    return COMPARISON.format(
        windows=report.held_out_windows,
        calls=SOLVER_CALLS,
        titles=", ".join(titles),
        distances=table(head, values),
        errors=table(("noise level", *errors), [("m/s^2", *(f"{error:.3f}" for error in errors.values()))]),
        drivable_raw=report.drivable_raw,
        drivable=report.drivable,
        nearest_sample=report.nearest_sample,
        nearest_held_out=report.nearest_held_out,
        copies="not copies" if report.nearest_sample > 0.7 * report.nearest_held_out else "close to copies",
    )


def _tracking(report: Report) -> str:
    limits = [(within, seconds) for within in WITHIN_M for seconds in HORIZONS_S]
    rows = [
        (name, *(f"{tracked.share_within(*limit):.0%}" for limit in limits), f"{tracked.share_limited:.0%}")
        for name, tracked in report.tracking.items()
    ]
    head = ("", *(f"{within:g} m, {seconds} s" for within, seconds in limits), "changed by the limits")
    starts = len(report.tracking["samples"].limited)
    return TRACKING.format(starts=starts, shares=table(head, rows), limited=LIMITED_M)


def _two_sample(report: Report) -> str:
    tested = report.told_apart
    rows = [
        (name, f"{distance:.3f}", f"{p_value:.3f}", *("-" if rate is None else f"{rate:.0%}" for rate in rates))
        for (name, (distance, p_value)), rates in zip(tested.full.items(), tested.rates.values(), strict=True)
    ]
    head = ("tested", "energy distance, all", "p-value, all", *(f"n = {size}" for size in TEST_SIZES))
    return TWO_SAMPLE.format(
        features=len(FEATURES),
        relabellings=PERMUTATIONS,
        vehicles=tested.vehicles,
        repeats=TEST_REPEATS,
        draws=TEST_DRAWS,
        rates=table(head, rows),
        samples_apart=_apart(report, "samples"),
        replay_apart=_apart(report, "replay"),
    )


def _apart(report: Report, name: str) -> str:
    """From which size on most tests tell apart."""
    rates = dict(zip(TEST_SIZES, report.told_apart.rates[name], strict=True))
    sizes = [size for size, rate in rates.items() if rate is not None and rate > 0.5]
    return f"Most tests tell {name} apart from n = {sizes[0]} on." if sizes else f"Most tests do not tell {name} apart."


def beside_section(report: Report, other: Report, which: str) -> str:
    """Section that puts a model beside another one.

    Args:
        report: Of the model.
        other: Of the other.
        which: What the other is.

    Returns:
        Markdown.
    """
    both = (report, other)
    rows = [
        ("drivable as drawn", *(f"{each.drivable_raw:.1%}" for each in both)),
        ("drivable after drawing again", *(f"{each.drivable:.1%}" for each in both)),
        ("mean distance to held-out, spreads", *(f"{_mean_distance(each):.3f}" for each in both)),
        ("energy distance", *(f"{each.told_apart.full['samples'][0]:.3f}" for each in both)),
    ]
    for index, size in enumerate(TEST_SIZES):
        rates = [each.told_apart.rates["samples"][index] for each in both]
        rows.append((f"told apart, n = {size}", *("-" if rate is None else f"{rate:.0%}" for rate in rates)))
    return BESIDE.format(which=which, rows=table(("", "this model", "the other"), rows))


def _mean_distance(report: Report) -> float:
    rows = report.comparisons
    return sum(row.model / row.held_out_spread for row in rows) / len(rows)


def full_process_section(costs: Sequence[FullProcess]) -> str:
    """Section on full processes with fewer calls."""
    rows = [
        (
            cost.process,
            cost.calls,
            f"{cost.distance:.3f}",
            f"{cost.from_reference:.3f}",
            "-" if cost.off_m is None else f"{cost.off_m:.2f}",
            f"{cost.drivable_raw:.1%}",
        )
        for cost in costs
    ]
    head = ("process", "calls", "to held-out", "to the reference's", "off, m", "drivable as drawn")
    return FULL.format(samples=FULL_SAMPLES, costs=table(head, rows), calls=SOLVER_CALLS)


def truncated_process_section(errors: Sequence[StrideError]) -> str:
    """Section on truncated processes with fewer calls."""
    calls = sorted(errors[0].by_calls)
    rows = [
        (error.noise_level, f"{error.two_draws:.2f}", *(f"{error.by_calls[count]:.2f}" for count in calls))
        for error in errors
    ]
    default = SamplerSettings().mutation_steps
    return TRUNCATED.format(
        strides=table(
            ("noise level", "two draws, m", *(f"{count} call{'s' * (count > 1)}, m" for count in calls)), rows
        ),
        default="one call per noise level" if default is None else f"{default} calls",
    )
