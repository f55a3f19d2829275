"""Report of a build: numbers for machines, a short table for people, and an estimate that writes nothing."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from benchmark.datasets.roots import DataSet
from benchmark.records.scene_assessment import is_unsolvable
from benchmark.records.seed_splits import strip_ego
from benchmark.report.words import pluralise
from generation.pipeline.estimate import (
    KEPT_SHARE,
    RuntimeTable,
    WorkEstimate,
    count_workers,
    estimate_planning,
    estimate_rendering,
)
from generation.pipeline.recordings import build_search, list_unlabelled_scenes, require_buildable
from generation.pipeline.settings import BuildSettings
from generation.search.attempts import read_cached_attempt
from generation.search.candidates import sum_exclusions
from generation.search.chains import AdversaryChain, SearchResult, find_first_units
from generation.search.definition import Search
from generation.search.verify import DiscardReason, format_masked_steps, sum_masked_steps


@dataclass(frozen=True, slots=True)
class BuildReport:
    """Numbers of one build; counts by reason where they are dictionaries.

    Attributes:
        scenes: Source scenes looked at.
        tried: Attempts, one per chosen vehicle.
        finished_before: Attempts that were already on disk (dry run only).
        survived: Generated scenes that passed verification with the wanted number of adversaries.
        discarded: Attempts that did not pass verification.
        written: Names of the scenes written, best first for ``adv``.
        dropped: Attempts that passed verification but are not written.
        not_tried: Objects that are not tried in the recorded scenes.
        unsolvable: Scenes that passed everything else and that no driver could have avoided: ``dropped`` for that, and
            ``written`` where they are kept; ``None`` where there was no search.
        masked_steps: By protocol, steps of the written scenes that its ground-truth check takes from every planner:
            because the recorded ego touches an ``adversary``, or only something else (``others``).
        requests: By kind of manoeuvre, if any was asked for: of how many vehicles (``asked``), how many of them drive
            in a direction in which they can do it (``tried``), attempts that passed verification and do it (``kept``),
            and how many are ``written``.
        panel: Members of the panel that ranked the scenes, the numbers of their seeds, and what it found; no part of
            the JSON where there was none.
        panel_s: Processor seconds that it took; no part of the JSON.
        runtime: How long the work took, on this or an earlier run; no part of the JSON, which is the same every time.
        unlabelled: Recorded scenes that were skipped because they have no annotations; no part of the JSON where there
            are none.
    """

    split: str
    scenes: int
    tried: int = 0
    finished_before: int = 0
    survived: int = 0
    discarded: dict[str, int] = field(default_factory=dict)
    written: tuple[str, ...] = ()
    dropped: dict[str, int] = field(default_factory=dict)
    not_tried: dict[str, int] = field(default_factory=dict)
    unsolvable: dict[str, int] | None = None
    masked_steps: dict[str, dict[str, int]] = field(default_factory=dict)
    adversaries: int = 1
    requests: dict[str, dict[str, int]] = field(default_factory=dict)
    surrogate: dict[str, Any] | None = None
    panel: dict[str, Any] | None = None
    panel_s: float = 0.0
    estimate: WorkEstimate | None = None
    runtime: RuntimeTable | None = None
    dry_run: bool = False
    unlabelled: tuple[str, ...] = ()
    collided: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        scenes: int,
        found: SearchResult,
        written: Sequence[AdversaryChain],
        surrogate: dict[str, Any] | None,
        adversaries: int,
    ) -> "BuildReport":
        """The report on a finished search for adversaries."""
        discarded = Counter(
            attempted.attempt.discard for attempted in found.tried if attempted.attempt.discard is not None
        )
        # Later selections in the same scene, with adversaries in it, are in candidates.jsonl.
        first_looks = [vehicles for earlier, vehicles in found.eligibility if not earlier]
        return cls(
            split="adv",
            scenes=scenes,
            tried=len(found.tried),
            survived=len(found.chains),
            discarded=dict(discarded),
            written=tuple(chain.name for chain in written),
            dropped=dict(Counter(reason.value for reason in found.dropped.values())),
            not_tried=sum_exclusions(first_looks),
            unsolvable={
                "dropped": discarded[DiscardReason.UNSOLVABLE.value],
                "written": sum(is_unsolvable(chain.judgements) for chain in written),
            },
            # The last adversary of a chain was checked with all the others in the scene.
            masked_steps=sum_masked_steps(chain.links[-1].attempt.masked_steps for chain in written),
            adversaries=adversaries,
            requests=_count_requests(found, written),
            surrogate=surrogate,
        )

    def as_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        values = asdict(self)
        del values["runtime"], values["panel_s"]
        if self.panel is None:
            del values["panel"]
        for name in ("unlabelled", "collided"):
            values[name] = list(values[name])
            if not values[name]:
                del values[name]
        return {**values, "written": list(self.written)}

    def sentence(self) -> str:
        """One sentence for people."""
        if self.dry_run:
            work = (
                ""
                if strip_ego(self.split) == "val-r"
                else f", {pluralise(self.tried, 'vehicle')} to try ({self.finished_before} of them done)"
            )
            about = "" if self.estimate is None else f"; {self.estimate.sentence()}"
            return f"would build {self.split} from {pluralise(self.scenes, 'scene')}{work}{about}; nothing was written"
        if strip_ego(self.split) == "val-r":
            left = f", {len(self.collided)} left out in which the driven ego touches others" if self.collided else ""
            return f"{pluralise(len(self.written), 'scene')} rendered again{left}"
        reasons = ", ".join(f"{count} {reason}" for reason, count in sorted({**self.discarded, **self.dropped}.items()))
        return (
            f"{pluralise(self.scenes, 'scene')}, {pluralise(self.tried, 'vehicle')} tried, "
            f"{pluralise(self.survived, 'scene')} passed verification (discarded: {reasons or 'none'}), "
            f"{pluralise(len(self.written), 'scene')} written"
        )

    def summary(self, *, verbose: bool = False) -> str:
        """The sentence, and below it how many vehicles were kept and dropped, by reason, and what was skipped.

        If ``verbose`` masked steps, too.
        """
        if not self.unlabelled:
            return self._summary(verbose=verbose)
        names = ", ".join(self.unlabelled[:3]) + (", ..." if len(self.unlabelled) > 3 else "")
        skipped = f"skipped {pluralise(len(self.unlabelled), 'scene')} without annotations ({names})"
        return f"{self._summary(verbose=verbose)}\n  {skipped}"

    def _summary(self, *, verbose: bool) -> str:
        if self.dry_run or strip_ego(self.split) == "val-r":
            return self.sentence()
        written_count = self.tried - sum(self.discarded.values()) - sum(self.dropped.values())
        rows = [("written", written_count, f"in {pluralise(len(self.written), 'scene')}")]
        for outcome, counts in (
            ("discarded", self.discarded),
            ("not kept", self.dropped),
            ("not tried", self.not_tried),
        ):
            rows += [
                (outcome, count, reason) for reason, count in sorted(counts.items(), key=lambda row: (-row[1], row[0]))
            ]
        lines = [
            f"{pluralise(self.scenes, 'scene')}, {pluralise(self.tried, 'vehicle')} tried, "
            f"{pluralise(len(self.written), 'scene')} written"
        ]
        lines += [f"  {outcome:<9} {count:>7}  {reason}" for outcome, count, reason in rows]
        if self.unsolvable is not None:
            lines.append(
                f"  unavoidable scenes: {self.unsolvable['dropped']} dropped, "
                f"{self.unsolvable['written']} among those written"
            )
        lines += [
            f"  {kind}: requested from {pluralise(row['asked'], 'vehicle')}, {row['tried']} tried, {row['kept']} kept, "
            f"{row['written']} written"
            for kind, row in self.requests.items()
        ]
        if verbose and self.masked_steps:
            lines.append(f"  {format_masked_steps(self.masked_steps)}")
        if self.panel is not None:
            lines.append(
                f"  panel: {', '.join(self.panel['members'])}, distracted; {self.panel['inert']} inert of "
                f"{pluralise(self.survived, 'scene')}; {self.panel_s:.0f} s of a processor"
            )
        if self.surrogate is not None:
            lines.append(
                f"  {self.surrogate['planner']} fails {self.surrogate['scenes_failed']} of "
                f"{pluralise(self.surrogate['scenes'], 'scene')}, {self.surrogate['colliding_samples']} of "
                f"{pluralise(self.surrogate['samples'], 'sample')}"
            )
        return "\n".join(lines)


def _count_requests(result: SearchResult, written: Sequence[AdversaryChain]) -> dict[str, dict[str, int]]:
    kept = Counter(attempted.unit.asked for attempted in result.tried if attempted.attempt.kept)
    wrote = Counter(link.unit.asked for chain in written for link in chain.links)
    return {
        kind.value: {"asked": request.vehicles, "tried": request.tried, "kept": kept[kind], "written": wrote[kind]}
        for kind, request in result.requests.items()
    }


def estimate_build(source: DataSet, split: str, settings: BuildSettings) -> BuildReport:
    """Preview of `generation.pipeline.split.build_split`, with an estimate; arguments and errors as there."""
    names = require_buildable(source, split, settings)
    if strip_ego(split) != "val-r":
        search = build_search(source, names, settings)
        return replace(_estimate_search(source, search, names, settings), split=split)
    scene_s, workers = _estimate_rendering_seconds(source, names, settings), count_workers(settings.where_rendered)
    about = WorkEstimate(0, 0.0, len(names), scene_s, workers, workers)
    skipped = list_unlabelled_scenes(source, settings)
    return BuildReport(split, len(names), estimate=about, dry_run=True, unlabelled=skipped)


def _estimate_search(source: DataSet, search: Search, names: Sequence[str], settings: BuildSettings) -> BuildReport:
    chosen = find_first_units(search, source, names, keep=False)
    units = [unit for _, of_scene in chosen for unit in of_scene]
    with_rounds = settings.keep_rounds and settings.adversaries == 1
    left = [unit for unit in units if read_cached_attempt(search, unit, with_rounds=with_rounds) is None]
    count, attempt_s = estimate_planning(search, units, left, source.scene, settings.adversaries)
    expected = round(KEPT_SHARE * len(units))
    for most in (settings.per_scene, settings.variants):
        expected = expected if most is None else min(expected, most * len(names))
    if settings.total is not None:
        expected = min(expected, settings.total)
    scene_s = _estimate_rendering_seconds(source, names, settings)
    planners, renderers = count_workers(settings.executor), count_workers(settings.where_rendered)
    about = WorkEstimate(count, attempt_s, expected, scene_s, planners, renderers)
    return BuildReport(
        "adv",
        len(names),
        len(units),
        len(units) - len(left),
        not_tried=sum_exclusions([vehicles for vehicles, _ in chosen]),
        adversaries=settings.adversaries,
        estimate=about,
        dry_run=True,
        unlabelled=list_unlabelled_scenes(source, settings),
    )


def _estimate_rendering_seconds(source: DataSet, names: Sequence[str], settings: BuildSettings) -> float:
    timing = settings.timing / "rendering"
    return estimate_rendering(settings.renderer, source.scene(names[0]), settings.frames, timing)
