"""What key frames that are not half a second apart do to the numbers of a run, as caveats."""

from collections.abc import Mapping

from benchmark.records.caveats import Caveat
from benchmark.records.run_schema import SceneFacts
from benchmark.report.words import counted


def time_caveats(scenes: Mapping[str, SceneFacts]) -> list[Caveat]:
    """Caveats about times: one of scenes at another rate, one of gaps in scenes at 2 Hz.

    None where key frames are steps.
    """
    truths = [facts.truth for facts in scenes.values() if facts.truth is not None]
    found = []
    rates_s = sorted({truth.interval_s for truth in truths if truth.interval_s is not None})
    if rates_s:
        there = sum(truth.interval_s is not None for truth in truths)
        apart = f"{rates_s[0]:.3g} s" if len(rates_s) == 1 else f"{rates_s[0]:.3g} to {rates_s[-1]:.3g} s"
        found.append(
            f"the key frames of {counted(there, 'scene')} are {apart} apart, not 0.5 s: exact and driving scores "
            "interpolate steps, and official protocols, whose steps are key frames, do not count these samples"
        )
    irregular = [truth for truth in truths if truth.interval_s is None and truth.irregular]
    if irregular:
        samples, cut = (sum(getattr(truth, name) for truth in irregular) for name in ("irregular", "cut_short"))
        found.append(
            f"{counted(samples, 'sample')} of {counted(len(irregular), 'scene')} have key frames ahead that are not "
            "half a second apart: exact and driving scores interpolate steps there"
            + (f" and say nothing beyond a gap over 0.75 s ({counted(cut, 'sample')})" if cut else "")
            + ", and official protocols take the k-th key frame for step k"
        )
    return [Caveat(kind="time", sentence=sentence) for sentence in found]
