"""The site's files: an index that says what the records say, the same bytes, and nobody else's folder touched."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.models import baselines
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, write_bytes
from benchmark.metrics.attacks import collect_scene_attacks, has_adversaries, select_counted_rows
from benchmark.metrics.effect import find_first_contacts, find_touched_scenes
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import BASELINES, SceneFacts
from benchmark.records.scene_assessment import DRIVER_NAMES
from benchmark.records.scene_pages import NO_SCENE_PAGES, ScenePages, StoredScenePage
from benchmark.report.palette import ADVERSARY, PLANNERS_ON_DARK, PLANNERS_ON_LIGHT, format_hexadecimal
from benchmark.report.table import Table
from leaderboard.build import find_stale_files, write_leaderboard
from leaderboard.frame.results import LeaderboardResults, read_results
from leaderboard.frame.runs import DataSetRuns
from leaderboard.page.sections import TABS
from leaderboard.site.index_data import PlacedTable, build_index, build_main_tables
from leaderboard.site.packing import decode_script, encode_script
from leaderboard.site.scene_facts import summarise_scenes
from leaderboard.site.scene_index import build_scene_index, describe_label
from leaderboard.site.site import INDEX_PATH, build_site_files
from leaderboard.tables.comparisons import planner_table
from leaderboard.tables.effect import effect_table
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made
from tests.leaderboard.site.big_workspace import DATA_NAME, IMAGE_TAG
from tests.leaderboard.site.conftest import FIGURE, Site
from tests.leaderboard.site.reading import with_baseline

ASSETS = Path(__file__).resolve().parents[3] / "leaderboard" / "site" / "assets"


@pytest.fixture(scope="module")
def index(site: Site) -> Any:
    """What pages show without loading a scene."""
    return value_of((site.index.parent / INDEX_PATH).read_bytes())


def value_of(script: bytes) -> Any:
    """What a browser takes a data script for: the text of the JavaScript string, parsed as JSON."""
    found = re.fullmatch(r"\"use strict\";\n.* = JSON\.parse\('((?:[^'\\\n]|\\.)*)'\);\n", script.decode("ascii"))
    assert found is not None
    meant = {"\\\\": "\\", "\\'": "'", "\\x3c": "<"}
    return json.loads(re.sub(r"\\x3c|\\.", lambda escape: meant[escape[0]], found[1]))


@given(value=st.recursive(st.none() | st.booleans() | st.integers() | st.text(), lambda inner: st.lists(inner)))
@settings(deadline=None, max_examples=25)
def test_a_script_says_any_value_and_nothing_else(value: Any) -> None:
    script = encode_script("window.X", value)
    assert value_of(script) == value
    assert b"<" not in script


def test_names_with_a_meaning_in_javascript_stay_names() -> None:
    value = {"__proto__": {"constructor": "</script><script>alert(1)</script>", "\u2028": 'it\'s \\ "quoted"'}}
    assert value_of(encode_script("window.X", value)) == value


def test_scenes_fail_in_the_index_as_in_the_records(site: Site, index: Any) -> None:
    scenes = {(scene["split"], scene["scene"]): scene for scene in index["scenes"]}
    assert {name for _, name in scenes} == set(site.made.scenes)
    summaries = {name[1:]: summary for name, summary in summarise_scenes(site.records, site.sheets).items()}
    for record in site.records:
        for protocol in record.summary.protocols:
            for scene, failed in find_touched_scenes(record, protocol).items():
                mark = scenes[record.run.split, scene]["marks"][record.planner][protocol]
                assert (mark in "xX") is (failed is True) and (mark in "-w") is (failed is None)
        touches = find_first_contacts(record)
        for scene, places in record.columns.places_of_scenes.items():
            known, shown = summaries[record.run.split, scene], scenes[record.run.split, scene]
            assert known.adversarial == has_adversaries(record)
            assert known.colliding.get(record.planner, 0) == touches.adversary[places].sum()
            assert known.bystanders.get(record.planner, 0) == touches.others[places].sum()
            assert shown["samples"].get(record.planner, [0])[0] == touches.adversary[places].sum()
            assert ("exact" in known.others.get(record.planner, [])) == touches.others[places].any()
            rows = [row for row in record.rows if row.scene == scene]
            hits = [row for row, hit in zip(rows, touches.adversary[places], strict=True) if hit]
            causes = Counter(row.diagnosis.cause for row in hits if row.diagnosis is not None)
            assert known.causes.get(record.planner, {}) == causes
            assert known.failed.get(record.planner, 0) == sum(row.status == "failed" for row in rows)
    assert {model["name"] for model in index["models"]} == set(site.made.planners)
    assert IMAGE_TAG in site.made.planners


def test_the_index_tells_contacts_with_the_adversary_from_others_and_never_says_zero_for_unknown() -> None:
    records = [
        touching("told", {"a": [True, False, None], "b": [False, None, None]}),
        touching("old", {"a": [True, None, None], "b": [None, None, None]}, told=False),
    ]
    first, second = build_scene_index(records, NO_SCENE_PAGES, (), frozenset())
    assert first["marks"] == {"told": {"exact": "X"}, "old": {"exact": "w"}}
    assert second["marks"] == {"told": {"exact": "a"}, "old": {"exact": "o"}}
    assert first["tally"] == {"exact": "1 of 1 planner hits the adversary, – of 1, whom is not said"}
    assert second["tally"] == {"exact": "0 of 2 planners hit the adversary, 1 another"}
    assert first["samples"] == {"told": [1, "; 1 sample hits it, 1 sample another"]}
    assert second["samples"] == {"told": [0, "; 1 sample another"]}
    (verdicts,) = first["page"]["tables"]
    assert [list(row) for row in verdicts["rows"]] == [
        ["old", "– whom not said", "–", "–", "0", ""], ["told", "✕ hits the adversary", "1", "1", "0", ""],
    ]  # fmt: skip
    ((_, table, _, _),) = build_main_tables([DataSetRuns("d", records)])
    assert [row[table.columns.index("adversary 3s")] for row in table.rows] == ["–", f"{100 / 6:.1f}"]


def touching(planner: str, scenes: Mapping[str, Sequence[bool | None]], *, told: bool = True) -> RunRecord:
    """A record of adversarial scenes; each sample hits the adversary, somebody else or nobody, and may say whom."""
    plain = hand_made(
        planner, {scene: [CLEAN if each is None else HIT for each in found] for scene, found in scenes.items()}
    )
    rows = []
    for row, adversary in zip(plain.rows, [each for found in scenes.values() for each in found], strict=True):
        facts = {
            "hit": None if adversary is None else "x",
            "first_contact_s": None if adversary is None else 0.1,
            **({"hit_adversary": adversary} if told else {}),
        }
        exact = row.outcomes["exact"].model_copy(update={"facts": facts})
        rows.append(row.model_copy(update={"outcomes": {"exact": exact}}))
    known = {scene: SceneFacts(source=scene, adversaries=1) for scene in scenes}
    run = plain.run.model_copy(update={"scene_facts": known})
    return RunRecord(plain.directory, run, tuple(rows), plain.summary)


def test_scenes_are_judged_in_the_index_as_in_the_records(site: Site, index: Any) -> None:
    scenes = {(scene["split"], scene["scene"]): scene for scene in index["scenes"]}
    summaries = {name[1:]: summary for name, summary in summarise_scenes(site.records, site.sheets).items()}
    assert all(not scene["verdict"] for (split, _), scene in scenes.items() if split == "val")
    touched, hardest_of = 0, dict.fromkeys(scenes, 0.0)
    for record in site.records:
        attacks = collect_scene_attacks(record)
        for scene in record.run.scenes:
            shown = scenes[record.run.split, scene]
            judgement = record.run.scene_facts[scene].judgement
            survives = [] if judgement is None else [name for name in DRIVER_NAMES if judgement.survives[name]]
            assert shown["survives"] == survives and bool(shown["verdict"]) is (judgement is not None)
            if judgement is not None:
                assert shown["order"].get("tight") == judgement.least_ttc_s
                faults = [name.replace("_", " ") for name in judgement.faults]
                assert shown["verdict"][2:] == [f"fault: {name}" for name in faults]
            rows = [row for row in select_counted_rows(record) if row.scene == scene and row.severity is not None]
            contacts = [row.severity.contact for row in rows if row.severity and row.severity.contact]
            severity = summaries[record.run.split, scene].severity.get(record.planner)
            if not contacts:
                assert severity is None or (severity.contacts == 0 and severity.delta_v is None)
                continue
            touched += 1
            with_adversary = [each for each in contacts if each.adversary]
            assert severity is not None and severity.contacts == len(with_adversary)
            assert severity.bystanders == len(contacts) - len(with_adversary)
            hardest = max((each.delta_v_ego_m_s for each in with_adversary), default=None)
            assert severity.delta_v == hardest
            hardest_of[record.run.split, scene] = max(hardest_of[record.run.split, scene], hardest or 0.0)
            assert severity.at_fault is attacks[scene].verdicts["at_fault"]
            assert severity.attributable is attacks[scene].verdicts["attributable"]
    assert touched and any(scene["judged"] for scene in scenes.values())
    # One number a scene, that of its table: the hardest contact of all planners, with the name of whose it is.
    for name, scene in scenes.items():
        found = [words for _, words, _ in scene["judged"] if words.startswith("delta-v")]
        assert -scene["order"].get("severe", 0.0) == hardest_of[name] and len(found) == (hardest_of[name] > 0)
        if found:
            planner = found[0].partition(" (")[2].removesuffix(")")
            delta_v = summaries[name].severity[planner].delta_v
            assert delta_v == hardest_of[name] and found[0] == f"delta-v {delta_v:.1f} m/s ({planner})"


def test_every_scene_has_its_files_and_one_without_a_sheet_says_so(site: Site, index: Any) -> None:
    for scene in index["scenes"]:
        assert scene["key"] == content_key(DATA_NAME, scene["split"], scene["scene"])[:16]
        assert (site.index.parent / "data" / "scenes" / f"{scene['key']}.js").is_file()
        assert scene["hasSheet"] is (scene["scene"] != site.made.without_sheet)
        assert (scene["thumb"] is not None) is scene["hasSheet"]
        for theme in ("thumb", "thumbDark"):
            assert scene[theme] is None or (site.index.parent / scene[theme]).is_file()


def test_a_number_leads_to_its_count_interval_protocol_and_record(site: Site, index: Any) -> None:
    (table,) = [table for table in index["tables"] if table["id"].endswith("-collision-exact")]
    average = table["columns"].index("col. avg")
    known = {f"{record.content_id} {record.planner} on {record.run.split}": record for record in site.records}
    for row, cells in zip(table["rows"], table["cells"], strict=True):
        unit, counted, protocol, who, source = index["origins"][cells[average]["record"]]
        assert [index["words"][place] for place in (unit, counted, protocol)] == ["%", "samples", "exact"]
        assert source == -1
        record = known[index["words"][who]]
        rate = record.summary.protocols["exact"].columns["collision"]["avg"]
        assert row[0].startswith(record.planner) and row[1] == record.run.split
        assert cells[average]["n"] == rate.denominator
        assert cells[average].get("low") == (None if rate.low is None else pytest.approx(100 * rate.low, rel=1e-3))


def test_what_pages_link_and_show_is_in_the_folder(site: Site, index: Any) -> None:
    pages = site.index.parent
    assert set(index["tabs"].values()) <= set(TABS) and {table["group"] for table in index["tables"]} <= set(
        index["tabs"]
    )
    assert {index["tabs"][group] for group in ("effect of the adversary", "causes", "published")} == {"results"}
    assert index["tabs"]["protocol vad"] == index["tabs"]["protocols against exact"] == "protocols"
    assert all((pages / unquote(figure["path"])).is_file() for figure in index["figures"])
    (rates,) = [figure for figure in index["figures"] if figure["title"] == "Rates"]
    assert (pages / unquote(rates["dark"])).read_bytes() == FIGURE.dark()
    assert not (site.board / unquote(rates["path"])).exists()
    page = (pages / "index.html").read_text()
    scripts = set(re.findall(r'(?:src|href)="([a-z_/]+\.(?:js|css))"', page))
    assert scripts == {path.name for path in ASSETS.iterdir() if path.suffix != ".html"} | {INDEX_PATH}
    assert "default-src 'none'" in page
    assert "site/index.html" in (site.board / "README.md").read_text()


@pytest.mark.parametrize("path", sorted(ASSETS.iterdir()), ids=lambda path: path.name)
def test_pages_ask_nobody_and_make_no_code_of_texts(path: Path) -> None:
    text = path.read_text().replace("http://www.w3.org/2000/svg", "")
    for forbidden in ("http:", "https:", "innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert forbidden not in text


def test_the_order_of_records_changes_no_byte(site: Site) -> None:
    sheets = ScenePages(site.sheets.splits, dict(list(site.sheets.scenes.items())[:2]))
    forwards, backwards = (
        build_site_files(read_results(records, sheets=sheets), []) for records in (site.records, site.records[::-1])
    )
    assert forwards == backwards and list(forwards) == list(backwards)


@pytest.fixture
def small(site: Site, no_drawing: None) -> LeaderboardResults:
    """Of one run, with the sheet of one scene."""
    scenes = dict([next(iter(site.sheets.scenes.items()))])
    return read_results(site.records[:1], sheets=ScenePages({}, scenes))


def test_a_changed_missing_or_foreign_file_makes_the_site_stale_until_written_again(
    small: LeaderboardResults, tmp_path: Path
) -> None:
    pages = tmp_path / "site"
    # A first site that was killed before its first file is begun again.
    write_bytes(pages / "data" / ".index.js.42.part", b"half")
    write_leaderboard(small, tmp_path)
    assert find_stale_files(small, tmp_path) == [] and not list(tmp_path.rglob(".*"))
    pictures = sorted(pages.glob("media/*/cameras/*.webp"))
    pictures[0].write_bytes(b"other")
    (pages / "app.js").unlink()
    write_bytes(pages / "media" / "gone" / "thumb.webp", b"old")
    assert sorted(sentence.removeprefix(f"{pages}/") for sentence in find_stale_files(small, tmp_path)) == sorted([
        "app.js is missing",
        f"{pictures[0].relative_to(pages)} differs from the run records",
        "media/gone/thumb.webp is no longer produced from the run records",
    ])  # fmt: skip
    write_leaderboard(small, tmp_path)
    assert find_stale_files(small, tmp_path) == []


def test_a_folder_that_is_no_site_of_ours_is_left_alone(small: LeaderboardResults, tmp_path: Path) -> None:
    write_bytes(tmp_path / "site" / "index.html", b"mine")
    with pytest.raises(InputError, match="--no-site"):
        write_leaderboard(small, tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["index.html"]
    write_leaderboard(small, tmp_path, site=False)
    assert (tmp_path / "site" / "index.html").read_bytes() == b"mine"
    assert "site/index.html" not in (tmp_path / "README.md").read_text()
    assert find_stale_files(small, tmp_path, site=False) == []


def test_a_sheet_of_other_content_is_refused(site: Site) -> None:
    name, stored = next(iter(site.sheets.scenes.items()))
    data = stored.sheet.data.model_copy(update={"fingerprint": "other"})
    other = StoredScenePage(stored.directory, stored.sheet.model_copy(update={"data": data}), None)
    with pytest.raises(InputError, match="challenger-bench sheets again"):
        build_scene_index(site.records, ScenePages(site.sheets.splits, {name: other}), (), frozenset())


def test_a_site_of_sheets_alone_and_of_nothing() -> None:
    empty = value_of(bytes(build_site_files(LeaderboardResults(()), [])[INDEX_PATH]))
    assert (empty["tables"], empty["models"], empty["scenes"], empty["attempts"]) == ([], [], [], [])


def test_attempts_say_why_vehicles_were_discarded(site: Site, index: Any) -> None:
    sheet = site.sheets.splits[DATA_NAME, "adv"]
    reasons = [attempt.discarded or "kept" for attempt in sheet.attempts]
    assert [attempt["reason"] for attempt in index["attempts"]] == reasons
    assert dict(index["attemptTally"]) == Counter(reasons)
    keys = {attempt["scene"]: attempt["key"] for attempt in index["attempts"] if "scene" in attempt}
    assert keys == {name: content_key(DATA_NAME, "adv", name)[:16] for name in keys}


def test_tables_have_names_of_their_own_whatever_data_sets_are_called() -> None:
    placed = [
        PlacedTable(Table(name, "", ("a",), ()), data, "") for data, name in (("a", "b-c"), ("a-b", "c"), ("", "p"))
    ]
    ids = [table["id"] for table in build_index(LeaderboardResults(()), placed, [], frozenset())["tables"]]
    assert ids == ["a-b-c", "a-b-c~2", "p"]


def test_settings_that_are_no_numbers_of_json_are_shown_as_text(site: Site) -> None:
    record = site.records[0]
    planner = record.run.planner.model_copy(update={"settings": {"gain": float("nan"), "file": "a'b"}})
    odd = replace(record, run=record.run.model_copy(update={"planner": planner}))
    index = build_index(LeaderboardResults((DataSetRuns(DATA_NAME, [odd]),)), [], [], frozenset())
    assert index["models"][0]["facts"][-1] == ["settings", "gain: NaN; file: a'b"]
    encode_script("window.X", index)


@given(
    label=st.dictionaries(
        st.sampled_from(["manoeuvre", "place", "closest_approach", "occurred", "other"]),
        st.recursive(
            st.none() | st.text(max_size=5) | st.floats(allow_nan=False),
            lambda inner: (
                st.lists(inner, max_size=2)
                | st.dictionaries(st.sampled_from(["gap_m", "side", "time_s", "kind"]), inner, max_size=3)
            ),
            max_leaves=6,
        ),
    )
)
@settings(deadline=None, max_examples=25)
def test_any_labels_have_words(label: dict[str, Any]) -> None:
    assert isinstance(describe_label(label), str)


def test_labels_in_words() -> None:
    label = {
        "manoeuvre": "cut-in-left",
        "place": "straight",
        "closest_approach": {"gap_m": 0.4, "side": "left", "time_s": 9.25},
        "occurred": [{"kind": "cut-in-left"}, {"kind": "blocking"}, {"kind": "blocking"}],
    }
    assert describe_label(label) == "cut-in-left; on: straight; closest 0.40 m, left, at 9.2 s; also blocking"


def test_the_index_stays_small(site: Site) -> None:
    """150 scenes and 10 planners have to stay below 2 MB with all tables."""
    scenes = build_scene_index(site.records, site.sheets, (), frozenset())
    for scene in scenes:
        del scene["page"]
    each = len(encode_script("window.X", scenes)) / (len(scenes) * len(site.made.planners))
    assert each < 600


def test_the_first_table_is_the_effect_by_the_paired_difference_and_baselines_are_apart(site: Site) -> None:
    results = read_results(with_baseline(site), sheets=site.sheets)
    index = build_index(results, [], [], frozenset())
    (main,) = index["mainTables"]
    effect = effect_table(results.frames[0])
    assert effect is not None and main["columns"][main["sorted"]] == "difference"
    assert {"any, adv", "any, unchanged"} < set(main["columns"]) and "split" not in main["columns"]
    full = {row[0]: dict(zip(effect.columns, row, strict=True)) for row in effect.rows}
    assert {row[0] for row in main["rows"]} == set(full)
    for row in main["rows"]:
        assert {head: full[row[0]][head] for head in main["columns"]} == dict(zip(main["columns"], row, strict=True))
    differences, apart = [float(row[main["sorted"]]) for row in main["rows"]], main["apart"]
    assert differences == sorted(differences[:apart]) + differences[apart:] and main["rows"][apart:][0][0] == "stop"
    (start,) = index["starts"]
    assert "val: recorded scenes" in start["splits"] and "adv: the same recordings" in start["splits"]
    # Whoever fails the scene that plays: nobody begins it as a baseline.
    shown = decode_script(bytes(build_site_files(results, [])[f"data/scenes/{start['scene']}.js"]).decode())["shown"]
    assert shown and all(names and "stop" not in names for names in shown)


def test_baselines_are_those_of_the_product() -> None:
    assert set(baselines()) == BASELINES


def test_pairs_of_planners_are_a_matrix_with_every_number_of_the_list(site: Site, index: Any) -> None:
    (shown,) = [table for table in index["tables"] if table["id"].endswith("-planners-adv-exact")]
    pairs = planner_table(DataSetRuns(DATA_NAME, site.records), "exact", "adv")
    assert pairs is not None
    names = shown["columns"][1:]
    assert [row[0] for row in shown["rows"]] == names and len(pairs.rows) == len(names) * (len(names) - 1) // 2
    value = pairs.columns.index("second − first (points)")
    for row in pairs.rows:
        first, second = names.index(row[0]), names.index(row[1])
        assert shown["rows"][first][second + 1] == row[value] and shown["rows"][second][first + 1] == row[value + 1]
        shade = shown["heat"][first][second + 1]
        assert (shade or " ")[0] == {"+": "p", "-": "m"}.get(row[value][0], " ")


def test_an_extensions_page_hangs_below_a_tab(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("leaderboard.site.site.list_offers", lambda kind: ("protocols near misses", "mine"))
    monkeypatch.setattr("leaderboard.site.site.call_extension", lambda kind, name, results: f"<p>{name}</p>")
    files = build_site_files(read_results(site.records[:1]), [])
    assert value_of(bytes(files[INDEX_PATH]))["pages"] == [
        {"tab": "protocols", "name": "near misses", "path": "pages/near%2520misses.html"},
        {"tab": "results", "name": "mine", "path": "pages/mine.html"},
    ]
    assert files["pages/mine.html"] == b"<p>mine</p>"


def test_miniatures_carry_their_mark(site: Site) -> None:
    planner = site.records[0].run.planner.model_copy(update={"miniature": True})
    small = [
        replace(record, run=record.run.model_copy(update={"planner": planner}))
        for record in site.records
        if record.planner == planner.name
    ]
    index = build_index(LeaderboardResults((DataSetRuns(DATA_NAME, small),)), [], [], frozenset())
    assert index["models"][0]["shown"] == f"{planner.name} §" and "pipeline" in index["models"][0]["lead"][0]
    assert index["mainTables"][0]["rows"][0][0] == f"{planner.name} §"
    assert any(note.startswith("§ miniature: demonstrates the pipeline") for note in index["mainTables"][0]["notes"])


def test_one_colour_for_the_adversary() -> None:
    """The page's style and the player's say it once each, and they say what Python draws with."""
    texts = {path.name: path.read_text().lower() for path in ASSETS.iterdir()}
    assert {name for name, text in texts.items() if format_hexadecimal(ADVERSARY) in text} == {
        "style.css",
        "player_style.js",
    }
    assert sum(text.count(format_hexadecimal(ADVERSARY)) for text in texts.values()) == 2
    planners = {format_hexadecimal(colour) for colour in (*PLANNERS_ON_LIGHT, *PLANNERS_ON_DARK)}
    assert all(colour in texts["player_style.js"] for colour in planners)
    for colour in (*PLANNERS_ON_LIGHT, *PLANNERS_ON_DARK):
        assert sum((one - other) ** 2 for one, other in zip(colour, ADVERSARY, strict=True)) > 80**2
