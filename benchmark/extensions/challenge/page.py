"""The verdict on an entry as a page: one file, no script, nothing from anywhere else."""

import base64
from collections import Counter
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Final

from benchmark.extensions.challenge.rules import ChallengeRules, format_rules
from benchmark.machine.storage import write_bytes
from benchmark.records.challenge import ChangedVehicle, EntryVerdict, RefusalReason, SceneVerdict
from benchmark.report.words import pluralise

PAGE_FILE: Final = "index.html"
_STYLE: Final = """
:root { --ground: #fcfcfb; --surface: #fff; --text: #1b1e21; --quiet: #5b6268; --line: #dcdfe1; --bad: #b00020;
  --good: #007a5a; color-scheme: light dark; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171a; --surface: #1a1e22; --text: #e4e7e9; --quiet: #9aa3ab;
  --line: #343b41; --bad: #ff7088; --good: #2bc79b; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 1.2rem clamp(.75rem, 3vw, 2rem) 3rem; background: var(--ground);
  color: var(--text); font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", sans-serif; }
h1 { font-size: 1.5rem; margin: .2rem 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 2rem 0 .6rem; }
h3 { font-size: 1rem; margin: 0; overflow-wrap: anywhere; }
p { margin: .3rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 550; color: var(--quiet); }
td.number { text-align: right; }
code, pre { font: .86em ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; }
pre { overflow-x: auto; padding: .8rem; background: var(--surface); border: 1px solid var(--line); border-radius: 6px; }
.quiet { color: var(--quiet); }
.verdict { font-weight: 650; }
.bad { color: var(--bad); }
.good { color: var(--good); }
.scene { display: grid; grid-template-columns: 240px minmax(0, 1fr); gap: 1rem; padding: 1rem; margin: .8rem 0;
  background: var(--surface); border: 1px solid var(--line); border-left: 4px solid var(--good); border-radius: 8px; }
.scene.refused { border-left-color: var(--bad); }
.scene img { width: 100%; height: auto; border-radius: 6px; }
.scene ul { margin: .4rem 0; padding-left: 1.2rem; }
li { overflow-wrap: anywhere; }
@media (max-width: 640px) { .scene { grid-template-columns: 1fr; } }
"""


def write_page(folder: Path, verdict: EntryVerdict, rules: ChallengeRules, pictures: Mapping[str, bytes]) -> Path:
    """Write the page of an entry, with PNG files by name of the scene; a scene may have none."""
    path = folder / PAGE_FILE
    write_bytes(path, format_page(verdict, rules, pictures).encode())
    return path


def format_page(verdict: EntryVerdict, rules: ChallengeRules, pictures: Mapping[str, bytes]) -> str:
    """The page; arguments as of `write_page`."""
    return "\n".join(_page(verdict, rules, pictures)) + "\n"


def _page(verdict: EntryVerdict, rules: ChallengeRules, pictures: Mapping[str, bytes]) -> Iterator[str]:
    name = escape(verdict.entry.name)
    yield '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{name}: {escape(verdict.challenge)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>"
    yield f"<h1>{name}: {_format_verdict(accepted=verdict.accepted)}</h1>"
    accepted = len(verdict.scenes) - len(verdict.refused)
    yield (
        f"<p>{accepted} of {pluralise(len(verdict.scenes), 'scene')} accepted under the rules of "
        f"{escape(verdict.challenge)}, checked against the recordings {escape(verdict.base.name)}.</p>"
    )
    yield (
        f'<p class="quiet">entry <code>{verdict.entry.fingerprint[:12]}</code>, recordings '
        f"<code>{verdict.base.fingerprint[:12]}</code>, rules <code>{verdict.rules[:12]}</code>, challenger-bench "
        f"{escape(verdict.version)}</p>"
    )
    if verdict.reasons:
        yield "<h2>The entry as a whole</h2>"
        yield _reasons(verdict.reasons)
    if verdict.refused:
        yield from _rule_table(verdict)
    yield "<h2>Scenes</h2>"
    yield (
        '<p class="quiet">Top view at the moment when the changed vehicle (orange) is nearest to the recorded '
        "ego (green); dashed: recorded positions of the vehicle. Refused scenes first.</p>"
    )
    for scene in sorted(verdict.scenes, key=lambda item: item.accepted):
        yield from _scene(scene, pictures.get(scene.scene))
    yield f"<h2>Rules</h2>\n<pre>{escape(format_rules(rules))}</pre>\n</body>\n</html>"


def _rule_table(verdict: EntryVerdict) -> Iterator[str]:
    counts = Counter(rule for scene in verdict.refused for rule in {reason.rule for reason in scene.reasons})
    yield "<h2>Broken rules</h2>\n<table>\n<tr><th>rule</th><th>scenes</th></tr>"
    for rule, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        yield f'<tr><td><code>{escape(rule)}</code></td><td class="number">{count}</td></tr>'
    yield "</table>"


def _scene(scene: SceneVerdict, picture: bytes | None) -> Iterator[str]:
    yield f'<section class="scene{"" if scene.accepted else " refused"}" id="{escape(scene.scene)}">'
    if picture is None:
        yield "<div></div>"
    else:
        data = base64.b64encode(picture).decode()
        yield f'<img alt="{escape(scene.scene)} from above" src="data:image/png;base64,{data}">'
    yield f"<div>\n<h3>{escape(scene.scene)}: {_format_verdict(accepted=scene.accepted)}</h3>"
    yield f'<p class="quiet">of {escape(scene.recording)}, {pluralise(scene.images, "image")}</p>'
    if scene.reasons:
        yield _reasons(scene.reasons)
    if scene.changed:
        yield "<table>\n<tr><th>changed</th><th>from</th><th>off by</th><th>gap to the ego</th><th>to others</th></tr>"
        yield from map(_vehicle, scene.changed)
        yield "</table>"
    for note in scene.notes:
        yield f'<p class="quiet">{escape(note)}</p>'
    yield "</div>\n</section>"


def _vehicle(vehicle: ChangedVehicle) -> str:
    when = "" if vehicle.nearest_ego_s is None else f" at {vehicle.nearest_ego_s:.1f} s"
    return (
        f"<tr><td>{escape(vehicle.category)} <code>{escape(vehicle.instance[:12])}</code></td>"
        f"<td>{vehicle.from_s:.1f} s</td><td>{vehicle.farthest_m:.3g} m</td>"
        f"<td>{_metres(vehicle.least_gap_ego_m)}{when}</td><td>{_metres(vehicle.least_gap_others_m)}</td></tr>"
    )


def _metres(gap: float | None) -> str:
    return "-" if gap is None else f"{gap:.2f} m"


def _reasons(reasons: tuple[RefusalReason, ...]) -> str:
    items = (f"<li>{escape(reason.sentence)} <code>{escape(reason.rule)}</code></li>" for reason in reasons)
    return f"<ul>{''.join(items)}</ul>"


def _format_verdict(*, accepted: bool) -> str:
    return f'<span class="verdict {"good" if accepted else "bad"}">{"accepted" if accepted else "refused"}</span>'
