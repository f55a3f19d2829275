"""Whether a search threatens: what its adversaries do, whom they defeat, and at what price, setting by setting.

Run as ``python bench/threat.py --data mini --data ROOT --seed 0 --setting today= --setting aim=threat_weight=1``. Each
(data set, setting, seed) is a case of its own below ``--folder``; attempts that are finished there are only read, so
the same command goes on where it was broken off. Planning and judging alone, nothing is rendered.
``docs/generation.md`` shows the table.
"""

import argparse
import functools
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.attacked import Attacked, attacked, recorded_features
from bench.threat_figure import write_figure
from benchmark import api
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.fairness.features import Run
from benchmark.fairness.realism import realism_of
from benchmark.machine.storage import read_kept_json, write_json
from benchmark.machine.workers import LocalProcesses, single_threaded
from generation.labels.manoeuvres import Manoeuvre
from generation.search.chains import SearchResult, search_chains
from generation.search.definition import Search
from generation.search.presets import PRESETS, Preset, hyper_parameters, trajectory_model

SQUEEZING: Final = (Manoeuvre.SQUEEZING_LEFT.value, Manoeuvre.SQUEEZING_RIGHT.value)
IN_FRONT: Final = tuple(
    kind.value
    for kind in (
        Manoeuvre.CUT_IN_LEFT,
        Manoeuvre.CUT_IN_RIGHT,
        Manoeuvre.CROSSING,
        Manoeuvre.BRAKING_AHEAD,
        Manoeuvre.BLOCKING,
    )
)
"""What a search that threatens should mostly do."""
LEAVES: Final = "leaves-the-area-around-the-ego"


@dataclass(frozen=True)
class Setting:
    """One way to search.

    Attributes:
        label: Its name in tables and files.
        preset: Where it starts from.
        changes: ``NAME=VALUE`` over the preset.
    """

    label: str
    preset: Preset
    changes: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> "Setting":
        """``LABEL=`` or ``LABEL=NAME=VALUE,NAME=VALUE``; ``preset=NAME`` among the changes starts from it."""
        label, _, rest = text.partition("=")
        changes = [each for each in rest.split(",") if each]
        preset = next((each[7:] for each in changes if each.startswith("preset=")), "default")
        if preset not in PRESETS:
            raise InputError(f"there is no preset {preset!r}; --setting {text} may start from {', '.join(PRESETS)}")
        return cls(label, preset, tuple(each for each in changes if not each.startswith("preset=")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", action="append", help="mini or the root of a data set with a map; may be repeated")
    parser.add_argument("--seed", action="append", type=int)
    parser.add_argument("--setting", action="append", help="LABEL=NAME=VALUE,...; the first one is compared with")
    parser.add_argument("--limit", type=int, help="only the first so many scenes")
    parser.add_argument("--folder", type=Path, default=Path("challenger-out") / "threat")
    parser.add_argument("--figure", type=Path, help="PNG or SVG: success against validity; of one data set")
    options = parser.parse_args()
    single_threaded()
    settings = [Setting.parse(text) for text in options.setting or ["default="]]
    found: list[dict[str, Any]] = []
    for data in options.data or ["mini"]:
        source = _source(data)
        for setting in settings:
            for seed in options.seed or [0]:
                path = options.folder / f"{setting.label}-{Path(data).name}-{options.limit or 'all'}-{seed}.json"
                row = read_kept_json(path)
                if not isinstance(row, dict) or row["search"] != [setting.preset, *setting.changes]:
                    row = measured(source, data, setting, seed, options)
                    write_json(path, row)
                found.append(row)
                print(f"{path.stem}: {row['kept']} of {row['tried']} kept", file=sys.stderr, flush=True)
    print(table(found))
    if options.figure is not None:
        write_figure(found, options.figure)


@functools.cache
def _source(data: str) -> DataSet:
    return open_data(Path(data)) if Path(data).is_dir() else api.open_data(data, workers=1)


def measured(source: DataSet, data: str, setting: Setting, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Search and judge one case."""
    prior = trajectory_model(setting.preset)
    search = Search(
        fingerprint=source.fingerprint(),
        hyper=hyper_parameters(setting.preset, None, setting.changes),
        seed=seed,
        prior=prior,
        prior_fingerprint=prior().fingerprint,
        state=options.folder / "state",
        timings=options.folder / "timings",
    )
    names = source.scene_names("val")[: options.limit]
    found = search_chains(search, source, names, LocalProcesses(1))
    of_scene: dict[str, list[Attacked]] = {}
    for chain in found.chains:
        of_scene.setdefault(chain.scene_name, []).append(attacked(source, chain))
    real = Path(data).is_dir()
    return {
        "data": Path(data).name,
        "setting": setting.label,
        "search": [setting.preset, *setting.changes],
        "seed": seed,
        **said(found),
        **sums([each for some in of_scene.values() for each in some]),
        "features": realism(source, names, of_scene) if real else None,
        "seconds": processor_seconds(search, found),
    }


def said(found: SearchResult) -> dict[str, Any]:
    """What the attempts say of themselves."""
    attempts = [each.attempt for each in found.tried]
    kept = [each for each in attempts if each.kept]
    return {
        "tried": len(attempts),
        "kept": len(kept),
        "scenes": len({each.scene for each in kept}),
        "why_not": dict(Counter(each.discard for each in attempts if each.discard is not None).most_common()),
        "manoeuvres": dict(Counter(each.labels.manoeuvre for each in kept if each.labels is not None).most_common()),
        "gaps": [each.closest_approach.gap_m for each in kept if each.closest_approach is not None],
    }


def sums(scenes: Sequence[Attacked]) -> dict[str, Any]:
    """What became of drivers and of the plans of ``constant-velocity``, over kept scenes."""
    faults: Counter[str] = Counter()
    for scene in scenes:
        faults.update(scene.faults)
    return {
        "careful": sum(scene.careful_survives for scene in scenes),
        "constant": sum(scene.constant_survives for scene in scenes),
        "at_fault": sum(scene.at_fault for scene in scenes),
        "attributable": sum(scene.at_fault and scene.careful_survives for scene in scenes),
        "colliding": sum(scene.colliding for scene in scenes),
        "samples": sum(scene.samples for scene in scenes),
        "faults": dict(faults),
        "each": [scene.as_json() for scene in scenes],
    }


def realism(source: DataSet, names: Sequence[str], of_scene: Mapping[str, Sequence[Attacked]]) -> dict[str, float]:
    """Realism of each feature against the recordings, none where nothing was kept."""
    recorded = {name: recorded_features(source, name) for name in names}
    mine: dict[str, Sequence[Run]] = {
        name: [run for each in of_scene.get(name, ()) for run in each.runs] for name in names
    }
    found = realism_of(mine, recorded)
    return {} if found is None else {each.name: each.realism for each in found.features}


def processor_seconds(search: Search, found: SearchResult) -> float:
    """Of all attempts, as they noted it when they were made."""
    notes = [read_kept_json(search.timing_path(each.unit)) for each in found.tried]
    return float(sum(sum(note["seconds"].values()) for note in notes if isinstance(note, dict)))


def entropy_bits(counts: Mapping[str, int]) -> float:
    """Entropy of manoeuvres, by counts."""
    share = np.array([count for count in counts.values() if count], dtype=np.float64)
    share /= share.sum() or 1.0
    return float((share * np.log2(1.0 / share)).sum()) if len(share) else 0.0


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown, a row for each data set and setting, seeds together."""
    head = [
        "data", "setting", "seeds", "tried", "kept", "leave the area", "squeezing", "in front", "entropy, bits",
        "careful human survives", "attributable", "at fault", "samples hit", "worst feature", "faults", "s/kept",
        "manoeuvres", "why not",
    ]  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "|---|---|" + "--:|" * 11 + "---|---|--:|---|---|"]
    for data, setting in dict.fromkeys((row["data"], row["setting"]) for row in rows):
        mine = [row for row in rows if (row["data"], row["setting"]) == (data, setting)]
        lines.append(f"| {' | '.join([data, setting, str(len(mine)), *_cells(mine)])} |")
    return "\n".join(lines)


def _cells(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Of one data set and setting."""
    tried, kept = (sum(row[name] for row in rows) for name in ("tried", "kept"))
    kinds, why_not, faults = (_together(rows, name) for name in ("manoeuvres", "why_not", "faults"))
    worst = [min(row["features"].items(), key=lambda pair: pair[1]) for row in rows if row["features"]]
    share = functools.partial(_percent, of=kept)
    return [
        str(tried),
        f"{kept} ({_percent(kept, tried)})",
        _percent(why_not[LEAVES], tried),
        share(sum(kinds[kind] for kind in SQUEEZING)),
        share(sum(kinds[kind] for kind in IN_FRONT)),
        f"{entropy_bits(kinds):.2f}",
        *(share(sum(row[name] for row in rows)) for name in ("careful", "attributable", "at_fault")),
        _percent(sum(row["colliding"] for row in rows), sum(row["samples"] for row in rows)),
        ", ".join(f"{name} {value:.2f}" for name, value in worst) or "-",
        _listed(faults) or "none",
        f"{sum(row['seconds'] for row in rows) / max(kept, 1):.1f}",
        _listed(kinds) or "-",
        _listed(why_not) or "-",
    ]


def _percent(part: int, of: int) -> str:
    return f"{100 * part / of:.0f} %" if of else "-"


def _together(rows: Sequence[dict[str, Any]], name: str) -> Counter[str]:
    total: Counter[str] = Counter()
    for row in rows:
        total.update(row[name])
    return total


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in counts.most_common() if count)


if __name__ == "__main__":
    main()
