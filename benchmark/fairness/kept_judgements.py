"""Facts of scenes for records, with judgements of those without one: made once, then found."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmark.datasets.judged import JUDGEMENTS_FILE, judgements_text, read_judgements
from benchmark.datasets.roots import DataSet
from benchmark.fairness.data_sets import judge_data
from benchmark.machine.storage import write_bytes
from benchmark.machine.workers import Executor
from benchmark.records.judgement import JudgementSummary, SceneJudgement
from benchmark.records.run_schema import SceneFacts

KEPT_FOLDER: Final = ".judgements"
"""Below the folder of runs: what is said of data sets that bring no judgements, a folder for each content."""


def judged_facts(data: DataSet, names: Sequence[str], kept: Path, executor: Executor) -> dict[str, SceneFacts]:
    """Facts of scenes as records have them, by name; scenes with adversaries are judged, recordings without are not.

    Args:
        kept: Folder of runs, where judgements of data sets without their own are kept and found again.
        executor: Where scenes without a judgement are judged; nothing depends on it.
    """
    facts = data.scene_facts(names)
    open_ = [name for name in names if facts[name].judgement is None and facts[name].adversaries != 0]
    if not open_:
        return facts
    folder = kept / KEPT_FOLDER / data.fingerprint()[:16]
    known = read_judgements(folder)
    missing = [name for name in open_ if name not in known]
    if missing:
        known = {**known, **judge_data(data, missing, executor)}
        write_bytes(folder / JUDGEMENTS_FILE, judgements_text(known).encode())
    return {name: _with(facts[name], known.get(name, ())) for name in names}


def _with(facts: SceneFacts, judgements: Sequence[SceneJudgement]) -> SceneFacts:
    said = JudgementSummary.of(judgements) if judgements and facts.judgement is None else facts.judgement
    return facts.model_copy(update={"judgement": said})
