"""Building a split of a package again from its recordings."""

from benchmark.datasets.roots import DataSet
from benchmark.datasets.split_reviews import record_verdicts
from generation.pipeline.settings import BuildSettings
from generation.splits.building import FrozenBuildReport, build_frozen
from generation.splits.packaged import NamedSplit
from generation.splits.unpacking import SplitPackage


def rebuild(source: DataSet, package: SplitPackage, split: NamedSplit, settings: BuildSettings) -> FrozenBuildReport:
    """Build a split of a package from its recordings as ``adv``, verdicts included; the same command resumes."""
    report = build_frozen(source, split, settings)
    verdicts = {} if package.review is None else dict(package.review.verdicts)
    own = {name: verdict for name, verdict in verdicts.items() if name in set(report.written)}
    if own and not settings.dry_run:
        record_verdicts(settings.out, own)
    return report
