"""Sheets of splits and ablation studies from a few numbers."""

from collections.abc import Sequence
from typing import Any

from benchmark.metrics.rates import Rate
from benchmark.records.ablation import VARIANTS, AblationReport, AblationRow
from benchmark.records.run_schema import DataFacts, PlannerFacts
from benchmark.records.scene_pages import AttemptFacts, ScenePages, SplitPage
from benchmark.records.statistics import BuildRuntime, SplitStatistics

STATISTICS: dict[str, Any] = {
    "split": "adv",
    "counts": {
        "instances": 1103, "ego_poses": 6720, "scenes": 4, "samples": 160, "sample_data": 6720, "annotations": 2257
    },
    "adversaries_per_scene": {"1": 3, "2": 1},
    "labelled": 5,
    "manoeuvres": [
        {
            "manoeuvre": "cut-in-left", "primary": 4, "occurred": 4, "places": {"junction": 1, "straight": 3},
            "median_gap_m": 0.4766,
        },
        {"manoeuvre": "tailgating", "primary": 1, "occurred": 3, "places": {"straight": 1}, "median_gap_m": 1.7},
        {"manoeuvre": "following", "primary": 0, "occurred": 2, "places": {}, "median_gap_m": None},
    ],
    "places": {"straight": 4, "junction": 1},
    "gap_m": {"least": 0.1, "tenth": 0.2, "median": 0.5, "ninetieth": 1.2, "most": 1.7},
    "time_to_collision_s": {"least": 0.8, "tenth": 0.84, "median": 1.05, "ninetieth": 1.31, "most": 1.4},
    "within_5_s": 4,
    "published_adv_nusc": {},
}  # fmt: skip
NO_ADVERSARY: dict[str, Any] = STATISTICS | {
    **{"adversaries_per_scene": {}, "labelled": 0, "manoeuvres": [], "places": {}},
    **{"gap_m": {}, "time_to_collision_s": {}, "within_5_s": 0},
}
ATTEMPTS = (("s0", None), ("s0", "touches-another"), ("s1", None), ("s1", "touches-another"), ("s1", "never-close"))
RUNTIME: dict[str, Any] = {
    "attempts": 5,
    "scenes": 2,
    "total_s": {"sampling": 10.0, "physics": 30.0, "scoring": 20.0, "rendering": 8.0, "other": 2.0},
}


def split_sheet(
    split: str,
    *,
    data: str = "d",
    statistics: dict[str, Any] | None = None,
    runtime: dict[str, Any] | None = None,
    attempts: Sequence[tuple[str, str | None]] = (),
) -> SplitPage:
    """A split in numbers; attempts are recorded scenes with why they were discarded."""
    return SplitPage(
        schema=1,
        data=DataFacts(name=data, version="v", fingerprint=f"{split:f<64}"),
        split=split,
        scenes=("s0", "s1"),
        statistics=SplitStatistics.model_validate(NO_ADVERSARY if statistics is None else statistics),
        attempts=tuple(
            AttemptFacts(source=source, agent=str(place), scene=None, discarded=why, manoeuvre=None)
            for place, (source, why) in enumerate(attempts)
        ),
        runtime=None if runtime is None else BuildRuntime.model_validate(runtime),
    )


def sheets_of(*splits: SplitPage) -> ScenePages:
    """Sheets of splits without any scene."""
    return ScenePages({(sheet.data.name, sheet.split): sheet for sheet in splits}, {})


def workspace_sheets(data: str = "d") -> ScenePages:
    """A recorded split and a generated one with everything."""
    adv = split_sheet("adv", data=data, statistics=STATISTICS, runtime=RUNTIME, attempts=ATTEMPTS)
    return sheets_of(adv, split_sheet("val", data=data))


def study(planner: str = "p", *, seed: int = 0, protocol: str = "exact") -> AblationReport:
    """An ablation study; in its last row nothing survived."""
    rows = []
    for place, variant in enumerate(VARIANTS):
        kept = 3 - place
        of_kept = {"value": 0.5, "numerator": 10 * kept, "denominator": 20 * kept, "low": 0.25, "high": 0.75}
        nothing = {"value": None, "numerator": 0, "denominator": 0, "low": None, "high": None}
        rows.append(
            AblationRow(
                name=variant.name, attempted=4, kept=kept, discarded={"never-close": 4 - kept},
                samples_attempted=80, samples_kept=20 * kept, colliding_samples=10 * kept,
                rate_attempted=Rate(value=kept / 8, numerator=10 * kept, denominator=80, low=0.0, high=0.5),
                rate_kept=Rate(**(of_kept if kept else nothing)), mean_gap_m=0.4 if kept else None,
            )
        )  # fmt: skip
    return AblationReport(
        schema=1, data=DataFacts(name="d", version="v", fingerprint="f" * 64), scenes=("s0", "s1"),
        planner=PlannerFacts(name=planner, privileged=False), protocol=(protocol, 1), seed=seed, hyper={},
        prior_fingerprint="f", rows=tuple(rows),
    )  # fmt: skip
