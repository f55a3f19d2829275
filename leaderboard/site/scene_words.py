"""What pages say of a scene, in words: marks of planners, tallies, who survives it, its facts and tables.

Everything here is text, or a number to sort by; pages only show it.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final
from urllib.parse import quote

from benchmark.records.run_schema import PlannerFacts
from benchmark.records.scene_assessment import DRIVER_NAMES, AssessmentSummary
from benchmark.report.cells import MINIATURE_WORDS, UNDEFINED, format_number
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.rows import name_cell
from leaderboard.frame.specification import Columns, Values, group_columns, number_columns, tabulate, text_columns
from leaderboard.site.scene_facts import SceneSeverity, SceneSummary
from leaderboard.tables.scenario_assessment import DRIVER_HEADS

LEGEND: Final = {
    "x": ("✕", "bad", "fails", "hits", "collides"),
    "X": ("✕", "bad", "hits the adversary", "hits", "hits the adversary"),
    "a": ("◇", "other", "hits another", "another", "hits another than the adversary"),
    "w": ("–", "open", "whom not said", "hits, whom is not said", "hits somebody, whom is not said,"),
    "o": ("○", "good", "clear", "clear", "is clear"),
    "-": ("–", "open", "cannot be said", "not judged", "was not judged"),
}
"""Sign, kind, and words on a scene, on one plan, and in a sentence, by mark. Kind ``bad`` is what fails a scene."""
ORDERS: Final = {
    "name": "name",
    "hardest": "most fail first",
    "easiest": "fewest fail first",
    "split": "planners disagree most",
    "severe": "most severe contact first",
    "tight": "least time to contact first",
    "late": "shortest last chance first",
}
_VERDICTS: Final = {
    "solvable": "somebody could avoid it",
    "unsolvable": "nobody could avoid it",
    "sound": "adversary without fault",
    "faulty": "adversary with a fault",
}
_FAULT: Final = "fault: "
_HEADS: Final[Mapping[str, str]] = {str(name): head for name, head in DRIVER_HEADS.items()}


def address(*parts: str, **params: str) -> str:
    """Address of a page of the site."""
    query = "&".join(f"{name}={quote(value, safe='')}" for name, value in params.items())
    return f"#/{'/'.join(quote(part, safe='') for part in parts)}{f'?{query}' if query else ''}"


def mark_planner(scene: SceneSummary, planner: str, protocol: str) -> str | None:
    """Mark in `LEGEND` of a planner on a scene; ``None`` where the protocol did not judge it."""
    verdicts = scene.verdicts.get(planner, {})
    if protocol not in verdicts:
        return None
    fails = verdicts[protocol]
    if scene.adversarial and fails is False and protocol in scene.others.get(planner, ()):
        return "a"
    if scene.adversarial and fails is None and protocol in scene.unsaid.get(planner, ()):
        return "w"
    return "-" if fails is None else "o" if not fails else "X" if scene.adversarial else "x"


def list_marks(scene: SceneSummary) -> dict[str, dict[str, str]]:
    """`mark_planner` by planner and protocol."""
    return {
        planner: {protocol: mark_planner(scene, planner, protocol) or "-" for protocol in by_protocol}
        for planner, by_protocol in scene.verdicts.items()
    }


def describe_tally(marks: Iterable[str], *, adversarial: bool) -> str:
    """Number of planners that fail a scene, and of those that hit others alone, of their marks."""
    listed = list(marks)
    bad, others, unsaid = (sum(mark in kind for mark in listed) for kind in ("xX", "a", "w"))
    decided = bad + others + listed.count("o")
    if not adversarial:
        fail = "fails" if bad == 1 else "fail"
        return f"{bad} of {pluralise(decided, 'planner')} {fail}" if decided else "not judged"
    hit = "hits" if bad == 1 else "hit"
    words = [f"{bad} of {pluralise(decided, 'planner')} {hit} the adversary"] if decided else []
    words += [f"{others} another"] if others else []
    words += [f"{UNDEFINED} of {unsaid}, whom is not said"] if unsaid else []
    return ", ".join(words) or "not judged"


def count_marks(marks: Iterable[str]) -> list[int]:
    """Numbers to sort scenes by: planners that fail, and the fewer of those that fail and those that do not."""
    listed = list(marks)
    bad = sum(mark in "xX" for mark in listed)
    return [bad, min(bad, sum(mark in "ao" for mark in listed))]


def describe_samples(scene: SceneSummary, planner: str) -> str:
    """Numbers of a planner's samples that collide, or nothing."""
    hits, others = scene.colliding.get(planner), scene.bystanders.get(planner)
    if not scene.adversarial:
        return f"; {pluralise(hits, 'colliding sample')}" if hits else ""
    words = [f"{pluralise(hits, 'sample')} {'hits' if hits == 1 else 'hit'} it"] if hits else []
    words += [f"{pluralise(others, 'sample')} another"] if others else []
    return f"; {', '.join(words)}" if words else ""


def judge_entry(said: AssessmentSummary | None, severity: Mapping[str, SceneSeverity]) -> dict[str, Any]:
    """What a card says of a scene's adversary and of the most severe contact, and what scenes are filtered by.

    ``judged`` (kind, text, title of each part), ``survives`` and ``hits`` (names of drivers), ``verdict`` (values of
    the filter), ``order`` (numbers, least first). The most severe contact is that of any planner, which is named: one
    number a scene, whoever is filtered by.
    """
    entry: dict[str, Any] = {"judged": [], "survives": [], "hits": [], "verdict": [], "order": {}}
    touched = [(of.delta_v, name) for name, of in severity.items() if of.delta_v is not None]
    contact = []
    if touched:
        delta_v, hardest = max(touched, key=lambda each: each[0])
        contact, entry["order"]["severe"] = [_describe_contact(hardest, severity[hardest])], -delta_v
    if said is None:
        return entry | {"judged": contact}
    survives, hits = _split_drivers(said)
    faults = [name.replace("_", " ") for name in said.faults]
    careful = "cc" in survives
    heads = ", ".join(_HEADS[name] for name in survives) or "no reference driver"
    entry["judged"] = [
        ["bad", "nobody could avoid it", ""]
        if said.unsolvable is True
        else ["good" if careful else "bad", f"careful human {'survives' if careful else 'does not survive'}", ""],
        ["", f"{len(survives)} of {len(DRIVER_NAMES)} drivers", f"survived by {heads}"],
    ]
    if said.margin_s is not None:
        title = "from when somebody could have reacted to the last chance"
        entry["judged"].append(["", f"last chance {_format_margin(said.margin_s)}", title])
    entry["judged"] += [*(["bad", fault, ""] for fault in faults), *contact]
    solvable = "unsolvable" if said.unsolvable is True else "solvable"
    verdict = [solvable, "faulty" if faults else "sound", *(_FAULT + fault for fault in faults)]
    order = {"tight": said.least_ttc_s, "late": said.margin_s}
    entry["order"] |= {name: value for name, value in order.items() if value is not None}
    return entry | {"survives": survives, "hits": hits, "verdict": verdict}


def _split_drivers(said: AssessmentSummary) -> tuple[list[str], list[str]]:
    survives: list[str] = [name for name in DRIVER_NAMES if said.survives.get(name)]
    return survives, [name for name in DRIVER_NAMES if name not in survives]


def _describe_contact(planner: str, of: SceneSeverity) -> list[str]:
    title = f"most severe contact of a plan of any planner: impact at {_format_amount(of.speed, 1, 'm/s')}"
    return ["", f"delta-v {_format_amount(of.delta_v, 1, 'm/s')} ({planner})", title]


def list_filters(entries: Sequence[Mapping[str, Any]], planners: Sequence[str]) -> list[dict[str, Any]]:
    """What scenes are filtered by: ``name``, ``label``, ``any`` (words for no choice) and ``choices`` of each."""
    judged = any(entry["verdict"] for entry in entries)
    drivers = [[name, _HEADS[name]] for name in DRIVER_NAMES] if judged else []
    faults = sorted({word for entry in entries for word in entry["verdict"] if word.startswith(_FAULT)})
    verdicts = [list(choice) for choice in _VERDICTS.items()] + [[fault, fault] for fault in faults] if judged else []
    names = ("data", "split", "manoeuvre")
    values = {name: list(dict.fromkeys(entry[name] for entry in entries if entry[name])) for name in names}
    filters = (
        ("data", "Data set", "all", values["data"]),
        ("split", "Split", "all", values["split"]),
        ("manoeuvre", "Manoeuvre", "all", sorted(values["manoeuvre"])),
        ("fails", "Fails", "any", planners),
        ("passes", "Does not fail", "any", planners),
        ("survives", "Survived by", "any", drivers),
        ("hits", "Not survived by", "any", drivers),
        ("verdict", "Verdict", "any", verdicts),
    )
    return [dict(zip(("name", "label", "any", "choices"), each, strict=True)) for each in filters]


def list_orders(entries: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Orders that tell these scenes apart, with their words."""
    known = {name for entry in entries for name in entry["order"]}
    return [[name, words] for name, words in ORDERS.items() if name in known or name not in ("severe", "tight", "late")]


def build_facts(
    entry: Mapping[str, Any], said: AssessmentSummary | None, siblings: Iterable[Mapping[str, Any]]
) -> list[list[Any]]:
    """Facts of a scene's page, a term and its lines each: of texts, and of texts with the address that they link."""
    split, labels, source = str(entry["split"]), entry["labels"], entry["source"]
    facts: list[list[Any]] = [["data set", [[entry["data"]]]], ["split", [[split]]]]
    if entry["manoeuvre"]:
        found = address("scenes", split=split, manoeuvre=entry["manoeuvre"])
        facts.append(["manoeuvre", [[[entry["manoeuvre"], found]]]])
    facts += [["adversaries" if len(labels) > 1 else "adversary", [[label] for label in labels]]] if labels else []
    facts += _list_judgement_facts(said, split) if said is not None else []
    facts += [["description", [[entry["description"]]]]] if entry["description"] else []
    facts.append(["length", [[_format_amount(entry["seconds"], 1, "s")]]])
    facts += [["made from", [[source]]]] if source != entry["scene"] else []
    same = [[[f"{each['scene']} ({each['split']})", address("scene", each["key"])]] for each in siblings]
    facts += [["of the same recording", same]] if same else []
    for masks, consistency, imaging in entry["quality"]:
        words = f"subject consistency {consistency}, imaging quality {imaging}"
        facts.append([f"video quality, masks from {masks}", [[words]]])
    return facts


def _list_judgement_facts(said: AssessmentSummary, split: str) -> list[list[Any]]:
    facts: list[list[Any]] = []
    for term, name, drivers in zip(("survived by", "not survived by"), ("survives", "hits"), _split_drivers(said)):
        links = [[_HEADS[driver], address("scenes", split=split, **{name: driver})] for driver in drivers]
        facts += [[term, [[part for link in links for part in (", ", link)][1:]]]] if links else []
    facts += [["verdict", [["nobody could avoid it"]]]] if said.unsolvable is True else []
    if said.margin_s is not None:
        aside = "" if said.has_map else " (no map: it may lead off the road)"
        words = f"{_format_margin(said.margin_s)} from when somebody could have reacted{aside}"
        facts.append(["last chance", [[words]]])
    ego = (
        ("gap", said.least_gap_m, 2, "m"),
        ("TTC", said.least_ttc_s, 2, "s"),
        ("TET", said.tet_s, 1, "s"),
        ("PET", said.pet_s, 1, "s"),
        ("BTN", said.max_btn, 2, ""),
    )
    amounts = ", ".join(f"{name} {_format_amount(value, digits, unit)}" for name, value, digits, unit in ego)
    facts.append(["recorded ego", [[amounts]]])
    faults, unknown = (", ".join(names).replace("_", " ") for names in (said.faults, said.unknown_faults))
    facts.append(["adversary's faults", [[faults or "none"], *([[f"not known: {unknown}"]] if unknown else [])]])
    return facts


def verdict_table(scene: SceneSummary, planners: Mapping[str, PlannerFacts], protocols: Sequence[str]) -> Table | None:
    """Verdicts on one scene of all planners that ran, under all protocols."""
    samples = ["samples that hit it", "another"] if scene.adversarial else ["colliding samples"]
    rows: dict[str, Values] = {}
    for name in planners.keys() & scene.verdicts.keys():
        marks = {protocol: mark_planner(scene, name, protocol) for protocol in protocols}
        counts = (of.get(name, 0) for of in (scene.colliding, scene.bystanders))
        rows[name] = {
            **{each: f"{LEGEND[mark][0]} {LEGEND[mark][2]}" for each, mark in marks.items() if mark is not None},
            **{head: _format_count(count) for head, count in zip(samples, counts)},
            "failed samples": str(scene.failed.get(name, 0)),
            "causes (exact)": ", ".join(f"{cause} {count}" for cause, count in scene.causes.get(name, {}).items()),
        }
    first = "A planner fails a scene if one of its counted samples collides within 3 s under the protocol."
    if scene.adversarial:
        first = (
            f"A planner fails a scene if one of its counted samples hits the adversary first within 3 s under the "
            f"protocol. ◇: one hits another first, and none the adversary. {UNDEFINED}: neither the record nor the "
            "protocol says whom."
        )
    kind = "Samples" if scene.adversarial else "Colliding samples"
    columns = [
        *group_columns("protocol", text_columns(*protocols)),
        *number_columns(*samples, "failed samples", "causes (exact)"),
    ]
    notes = (first, f"{kind} and causes are those under protocol exact.")
    return _tabulate("verdicts", "Who fails this scene", planners, columns, rows, notes)


def severity_table(scene: SceneSummary, planners: Mapping[str, PlannerFacts]) -> Table | None:
    """How severe the plans of each planner are on one scene."""
    others = ["with others"] if scene.adversarial else []
    heads = ["contacts", "at fault", "attributable", *others, "whose fault", "kind", *_WORST, *_NEAR]
    rows: dict[str, Values] = {}
    for name, of in scene.severity.items():
        fatal = None if of.fatal is None else 100 * of.fatal
        amounts = ((of.speed, 1), (of.delta_v, 1), (fatal, 2), (of.ttc, 2), (of.gap, 2))
        verdicts = [{None: UNDEFINED, True: "yes", False: "no"}[said] for said in (of.at_fault, of.attributable)]
        cells = [str(of.contacts), *verdicts, *[_format_count(of.bystanders)][: len(others)], of.fault or UNDEFINED]
        cells += [of.kind or UNDEFINED]
        rows[name] = dict(zip(heads, [*cells, *(format_number(*amount) for amount in amounts)], strict=True))
    columns = [
        *group_columns("attack", number_columns("contacts", "at fault", "attributable", *others)),
        *group_columns("most severe contact", text_columns("whose fault"), number_columns("kind", *_WORST)),
        *group_columns("without contact, least", number_columns(*_NEAR)),
    ]
    whom = "the adversary first" if scene.adversarial else "anybody"
    also = "; with others: somebody else first" if scene.adversarial else ""
    notes = (
        f"Contacts: samples whose plan touches {whom} within 3 s{also}. At fault, attributable: whether any is the "
        "planner's fault (fault@1, docs/fault.md), and whether the careful human survives the scene besides; "
        f"{UNDEFINED}: nobody can tell.",
        "TTC, gap: plans without contact and the adversary (docs/severity.md).",
    )
    return _tabulate("severity", "How severe it is", planners, columns, rows, notes)


def _tabulate(
    name: str,
    title: str,
    planners: Mapping[str, PlannerFacts],
    columns: Columns,
    rows: Mapping[str, Values],
    notes: Sequence[str],
) -> Table | None:
    """Rows of planners in their order; ``None`` without any."""
    shown = {planner: facts for planner, facts in planners.items() if planner in rows}
    marks = [f"{MINIATURE_WORDS}."] if any(facts.miniature for facts in shown.values()) else []
    named = [{"planner": name_cell(planner, facts), **rows[planner]} for planner, facts in shown.items()]
    return tabulate(name, title, [*text_columns("planner"), *columns], named, [*notes, *marks]) if named else None


_WORST: Final = ("impact, m/s", "delta-v, m/s", "P(fatal), %")
_NEAR: Final = ("TTC, s", "gap, m")


def _format_count(count: int | None) -> str:
    return UNDEFINED if count is None else str(count)


def _format_margin(seconds: float) -> str:
    return f"{format_number(seconds, 1, signed=True)} s"


def _format_amount(value: float | None, digits: int, unit: str) -> str:
    text = format_number(value, digits)
    return text if value is None or not unit else f"{text} {unit}"
