"""Every command with each wrong argument and what the refusal says, and every dry run; nothing needs to be built.

In the arguments ``{new}`` is a folder that does not exist, ``{file}`` a text file, ``{empty}`` an empty folder and
``{csv}`` a plan file without rows.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.whole_product import ABSENT, command_is_installed

_OUT = "--out {new}/out"
_HEAVY = {"torch", "nuscenes"}
MISTAKES: tuple[tuple[str, str], ...] = (
    (f"evla --model idm {_OUT}", "Did you mean 'eval'?"),
    (f"eval {_OUT}", "name a planner with --model"),
    (f"eval idm {_OUT}", "write --model idm"),
    (f"eval adv --model idm {_OUT}", "write --split adv"),
    (f"eval {{csv}} {_OUT}", "write --plans"),
    (f"eval --modle idm {_OUT}", "--model"),
    (f"eval --model VAD {_OUT}", "did you mean vad?"),
    (f"eval --model unaid {_OUT}", "did you mean uniad?"),
    (f"eval --model bad.py:Shape {_OUT}", "use --model bad:Shape"),
    (f"eval --model my_planner {_OUT}", "or your own with --model package.module:Class"),
    (f"eval --model my_missing.planner:Mine {_OUT}", "run the command in the folder that holds my_missing"),
    (f"eval --model slips:Unfinished {_OUT}", "it has no method plan"),
    (f"eval --model slips:Raises {_OUT}", "RuntimeError: no weights; --debug shows where"),
    (f"eval --model idm --split ADV {_OUT}", "did you mean adv?"),
    (f"eval --model idm --split test {_OUT}", "it has val, val-r, adv"),
    (f"eval --model idm --data {{new}} {_OUT}", "there is no folder"),
    (f"eval --model idm --data {{empty}} {_OUT}", "give the folder that contains for example v1.0-mini/"),
    (f"eval --model idm --data demo {_OUT}", "run: challenger-bench demo"),
    (f"eval --model uniad-unoptimised {_OUT}", "no weights for uniad"),
    (f"eval --model idm --scenes scene-800 {_OUT}", "did you mean scene-800"),
    (f"eval --model idm --protocol exakt {_OUT}", "did you mean exact?"),
    (f"eval --plans {{empty}} {_OUT}", "must end in .csv"),
    (f"drive --model vad-mini {_OUT}", "add --sensor schematic"),
    (f"failures --model idm {_OUT}", "make it with: challenger-bench eval --model idm --split adv"),
    (f"leaderboard {_OUT}", "run challenger-bench eval"),
)
"""What new users do in their first hour."""
SLIPS = """
class Unfinished:
    name = "unfinished"
    def reset(self, scene): pass

class Raises(Unfinished):
    def __init__(self): raise RuntimeError("no weights")
"""
_CORE: tuple[tuple[str, str], ...] = (
    (f"eval --model idm --split adv --scenes scene-1 {_OUT}", "scene-1"),
    (f"eval --model idm --native uniad {_OUT}", "--plans"),
    (f"eval --plans {{csv}} --native unaid {_OUT}", "native protocol"),
    (f"eval --plans {{new}}/plans.csv {_OUT}", "does not exist"),
    (f"eval --plans {{csv}} {_OUT}", "no column"),
    (f"eval --results {{new}}/results.pkl {_OUT}", "there is no result file"),
    (f"eval --results {{file}} {_OUT}", "begins with"),
    (f"eval --results {{empty}} {_OUT}", "the folder is empty"),
    (f"eval --results {{file}} --format unaid {_OUT}", "did you mean uniad"),
    (f"eval --model idm --format uniad {_OUT}", "--results"),
    (f"eval --model idm --model stop --name mine {_OUT}", "--name mine names one planner"),
    (f"eval --model idm --dump-results unaid {_OUT}", "did you mean uniad"),
    (f"eval --model vad --checkpoint {{new}}/vad.pth {_OUT}", "there is no checkpoint"),
    (f"eval --model uniad --device gpu {_OUT}", "unknown device 'gpu'"),
    (f"eval --model uniad --precision float8 {_OUT}", "unknown precision 'float8'"),
    (f"eval --model idm --workers -1 {_OUT}", "--workers"),
    (f"eval --model sparsedrive --as-published memory --workers 2 {_OUT}", "leave --workers 2 out"),
    (f"eval --model vad-mini --as-published memory {_OUT}", "it has can-after"),
    (f"eval --model idm --as-published all {_OUT}", "no published run"),
    (f"eval --plans {{csv}} --as-published all {_OUT}", "--model"),
    (f"drive --model unaid {_OUT}", "did you mean uniad?"),
    (f"drive --no-baselines {_OUT}", "name a planner"),
    (f"drive --model uniad {_OUT}", "add --sensor schematic"),
    (f"drive --engine neuroncap@paper --latency 100 {_OUT}", "not simulate latency"),
    (f"drive --scenarios own {_OUT}", "add --engine neuroncap@code"),
    (f"drive --latency 150 {_OUT}", "not a multiple of 100"),
    (f"drive --scenes scene-1 {_OUT}", "scene-1"),
    (f"drive --split vla {_OUT}", "it has val, val-r, adv"),
    (f"drive --workers -1 {_OUT}", "--workers"),
    (f"drive --address head:1 {_OUT}", "--executor ray"),
    (f"drive --model uniad --sensor schematic --device gpu {_OUT}", "unknown device 'gpu'"),
    (f"drive --data {{new}}/data {_OUT}", "there is no folder"),
    (f"drive --model http://127.0.0.1:9 {_OUT}", "add --sensor schematic"),
    (f"drive --model http://127.0.0.1:9/infer --sensor schematic {_OUT}", "write http://HOST:PORT"),
    (f"drive --model uniad=http://127.0.0.1:9 --sensor schematic {_OUT}", "a planner"),
    (f"drive --model idm --image-format png {_OUT}", "leave it out"),
    (f"drive --sensor schematc {_OUT}", "did you mean schematic?"),
    (f"drive --sensor none=http://127.0.0.1:9 {_OUT}", "rename it"),
    (f"drive --accept-torch-tensors {_OUT}", "--sensor http://HOST:PORT"),
    (f"eval --model idm --image-format torch {_OUT}", "leave it out"),
    (f"eval --model idm --limit 0 {_OUT}", "--limit"),
    ("eval --model idm --out {file}/out", "is a file"),
    ("eval --model idm --out /proc/out", "cannot write below /proc"),
    (f"eval --model idm --data {{file}} {_OUT}", "is not a folder"),
    (f"data pack nothing --to {{new}}/p.zip {_OUT}", "no frozen split of that name"),
    (f"data pack mini-adv-3 --to {{new}}/p.tar {_OUT}", "must end in .zip"),
    (f"data pack mini-adv-3 --rules {{new}}/rules.toml --to {{new}}/p.zip {_OUT}", "does not exist"),
    (f"data unpack {{new}}/p.zip --to {{new}}/to {_OUT}", "cannot read"),
    (f"data unpack {{file}} --to {{new}}/to {_OUT}", "cannot be unpacked"),
    (f"generate --split avd {_OUT}", "did you mean adv?"),
    (f"generate --source-split adv {_OUT}", "only split is val"),
    (f"generate --surrogate nobody {_OUT}", "nobody"),
    (f"generate --surrogate-checkpoint {{file}} {_OUT}", "--surrogate"),
    (f"generate --set roundz=1 {_OUT}", "rounds"),
    (f"generate --size 3x3 {_OUT}", "--size"),
    (f"generate --manoeuvre cut-in-lef {_OUT}", "did you mean cut-in-left"),
    (f"generate --manoeuvre distant {_OUT}", "when no other kind does"),
    (f"generate --manoeuvre tailgating --manoeuvre tailgating {_OUT}", "repeats a kind"),
    (f"generate --split val-r --manoeuvre tailgating {_OUT}", "this command does"),
    (f"generate --variants 2 --per-scene 2 {_OUT}", "give only one"),
    (f"generate --address localhost:6379 {_OUT}", "--executor"),
    (f"generate --denoiser {{new}}/model.ckpt {_OUT}", "--denoiser"),
    (f"generate --device gpu {_OUT}", "unknown device 'gpu'"),
    ("generate --out {file}", "is a file"),
    (f"generate --data {{new}} {_OUT}", "there is no folder"),
    (f"generate --executor ray --address nowhere {_OUT}", "HOST:PORT"),
    (f"generate --from {{empty}} {_OUT}", "has no ScenarioNet files"),
    (f"generate --from {{new}}/edited.pkl {_OUT}", "there is no folder"),
    (f"generate --from {{empty}} --seeds 0,1 {_OUT}", "edited scenes are not searched"),
    (f"ablate --model nobody {_OUT}", "nobody"),
    (f"ablate --set temperature=nan {_OUT}", "temperature"),
    (f"ablate --scenes scene-1 {_OUT}", "scene-1"),
    (f"ablate --source-split vla {_OUT}", "val"),
    ("ablate --out {file}/out", "is a file"),
    (f"transfer --protocol exakt {_OUT}", "did you mean exact?"),
    (f"transfer --figure {{new}}/matrix.pdf {_OUT}", ".png"),
    (f"transfer --figure {{file}}/matrix.png {_OUT}", "is a file"),
    (f"transfer {_OUT}", "eval"),
    (f"rescore --data {{new}} {_OUT}", "there is no folder"),
    (f"rescore {_OUT}", "run challenger-bench eval first"),
    (f"rescore --records {{file}} {_OUT}", "is a file"),
    (f"sheets --split vla {_OUT}", "it has val"),
    (f"sheets --scenes scene-1 {_OUT}", "scene-1"),
    (f"sheets --rounds {_OUT}", "--keep-rounds"),
    ("sheets --out {file}", "is a file"),
    (f"leaderboard --to {{file}} {_OUT}", "is a file"),
    ("data info {new}", "there is no folder"),
    ("data stats mini --split vla", "val"),
    ("data stats {empty}", "no version folder"),
    ("data stats mini --recordings {new}", "there is no folder"),
    ("data show mini --to {new}/pictures --scenes scene-1", "scene-1"),
    ("data show mini --to {file}", "is a file"),
    ("data check {new}", "there is no folder"),
    ("data import waymo {empty} --out {new}/root", "No such command 'waymo'"),
    ("data import scenarionet {new} --out {new}/root", "there is no folder"),
    ("data import scenarionet {empty} --out {file}", "is a file"),
    ("data build --size big", "--size"),
    ("data build --town-scenes 0", "--town-scenes"),
    ("data build --root {new}/town --off-path", "--train-scenes"),
    ("data build --root {new}/town --driven {new}/drives", "does not exist"),
    ("data build --root {new}/town --driven {empty}", "drive.json"),
    ("data build --root {new}/town --driven {empty} --train-scenes 3", "--train-scenes"),
    ("data build --root {file}", "is a file"),
    ("weights import {new}/VAD_tiny.pth", "give an existing file or folder"),
    ("weights import {file} --model vat-tiny", "did you mean vad-tiny"),
    ("weights import {file} --normalisation rgb", "rgb"),
    ("weights fetch vad-tinny", "did you mean vad-tiny"),
    ("weights anchors --model uniad --data mini --out {new}/a.safetensors", "sparsedrive"),
    ("verify model", "--model"),
    ("verify model --model vat-tiny", "did you mean vad-tiny"),
    ("verify physics --golden {new}", "--golden"),
    ("verify results --golden {new}", "--golden"),
    ("demo --check", "--full"),
    ("demo --out {file}", "is a file"),
    ("demo --town-scenes 0", "town"),
)
_OF_EXTENSIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "benchmark.extensions.http": (
        (f"drive --model http://127.0.0.1:9 --sensor schematic {_OUT}", "nobody answers at http://127.0.0.1:9 "),
        (f"drive --sensor http://127.0.0.1:9 {_OUT}", "nobody answers at http://127.0.0.1:9 "),
        (f"eval --model http://127.0.0.1:9 {_OUT}", "nobody answers at http://127.0.0.1:9 "),
        ("serve", "--model"),
        ("serve --model unaid", "did you mean uniad?"),
        ("serve --model uniad", "there are no weights for uniad"),
        ("serve --model idm --port 0", "requests do not carry"),
        ("serve --model vad-mini --host 203.0.113.7", "choose another --port or --host"),
        ("serve --model vad-mini --port 65536", "--port"),
    ),
    "benchmark.extensions.reproduce": (
        (f"reproduce --model unaid {_OUT}", "did you mean uniad?"),
        (f"reproduce --model uniad --data {{empty}} {_OUT}", "no weights for uniad"),
        (f"reproduce --model uniad-mini {_OUT}", "there are no published numbers for uniad-mini"),
        (f"reproduce --model vad-mini --expected {{file}} {_OUT}", "must end in .json"),
        (f"reproduce --model uniad --checkpoint {{file}} --split adv {_OUT}", "not for adv"),
        (f"reproduce --model uniad --checkpoint {{file}} --workers 2 {_OUT}", "leave --workers 2 out"),
    ),
    "benchmark.extensions.infos": (
        (f"data export infos {{new}} --for uniad --to {{new}}/to {_OUT}", "there is no folder"),
        (f"data export infos mini --for unaid --to {{new}}/to {_OUT}", "unaid"),
        ("verify infos", "needs --golden"),
        ("verify infos --golden {empty}", "has no manifest"),
    ),
    "benchmark.extensions.cards": (
        (f"leaderboard card --to {{new}}/to --hub mini --records {{empty}} {_OUT}", "--hub must be ORG/NAME"),
        ("verify hub", "needs --golden"),
        ("verify hub --golden {empty}", "has no expected.json"),
    ),
    "benchmark.extensions.exchange": (
        (f"data export scenarionet {{new}} --to {{new}}/to {_OUT}", "there is no folder"),
        (f"data export scenarionet mini --scenes scene-1 --to {{new}}/to {_OUT}", "scene-1"),
        (f"data export scenarionet mini --split vla --to {{new}}/to {_OUT}", "it has val, val-r, adv"),
        (f"data export nuscenes mini --to {{file}} {_OUT}", "is a file"),
    ),
    "generation.extensions.magicdrive": (
        (f"generate --renderer magicdrive {_OUT}", "weights"),
        (f"generate --renderer magicdrive --weights-folder {{new}} {_OUT}", "--weights-folder"),
    ),
    "benchmark.extensions.quality": (
        (f"quality --masks boxs {_OUT}", "did you mean boxes"),
        (f"quality --split vla {_OUT}", "it has val"),
        (f"quality {_OUT}", "no weights"),
        ("quality --out {file}", "is a file"),
    ),
    "leaderboard.extensions.films": (
        (f"film --to {{new}}/films {_OUT}", "no scene sheet"),
        (f"film --to {{new}}/films --model unaid {_OUT}", "did you mean uniad"),
        (f"film --to {{new}}/films --model uniad {_OUT}", "there are no run records"),
        (f"film --to {{file}} {_OUT}", "is a file"),
    ),
    "benchmark.extensions.submissions": (
        (f"leaderboard submit-check {{new}} {_OUT}", "there is no folder"),
        (f"leaderboard submit-check {{empty}} --data {{new}} {_OUT}", "there is no folder"),
    ),
    "adapters.extensions.training": (
        ("train denoiser --tracks {new} --out {new}/weights.pt", "--tracks"),
        ("train planner --model unaid-mini --data {empty} --out {new}/w.safetensors", "did you mean uniad-mini"),
        ("train planner --model vad-mini --data {empty} --out {new}/w.pt", ".safetensors"),
        ("train judge {new}/w.safetensors --data {empty}", "does not exist"),
    ),
}
WRONG = (*MISTAKES, *_CORE, *(each for name, wrong in _OF_EXTENSIONS.items() if name not in ABSENT for each in wrong))
_DRY: tuple[tuple[str, str], ...] = (
    (f"eval --dry-run --model uniad --split adv --data mini@1 {_OUT}", "run uniad-mini on 19 scenes of adv"),
    (
        f"generate --dry-run --from mini-adv-1 --data mini@1 --scenes scene-8000-1a46b7c9 {_OUT}",
        "build split adv from frozen split mini-adv-1, 1 scene;",
    ),
    (f"generate --dry-run --from {{empty}} {_OUT}", "build split adv from the edited scenes"),
    (f"eval --dry-run --model idm --data mini@1 --json {_OUT}", "run idm on 19 scenes of adv"),
    (f"drive --dry-run --model idm --data mini@1 --no-baselines {_OUT}", "drive idm through 19 scenes of adv"),
    (f"sheets --dry-run --limit 2 --split val-r {_OUT}", "write sheets of 2 scenes of val-r"),
    (f"quality --dry-run --masks boxes --data mini@1 {_OUT}", "score 19 scenes of adv"),
    (f"generate --dry-run --surrogate vad --data mini@1 {_OUT}", "build split adv from 10 scenes"),
    (f"ablate --dry-run --scenes scene-8003 {_OUT}", "search 1 scene four times"),
)
DRY = tuple(each for each in _DRY if command_is_installed(each[0]))
"""What each says that it would do once the embedded data set is built."""


@dataclass(frozen=True)
class Refusal:
    """What became of one command: how long it took a process that has run commands before, what lies in the cache or in
    the new folder afterwards, and which of torch and the devkit it imported."""

    sentence: str
    refused: bool
    seconds: float
    left: list[str]
    imported: list[str]


def make_places(folder: Path) -> dict[str, str]:
    """What stands for the names in braces; modules with planners lie in the folder itself."""
    (folder / "empty").mkdir()
    for name in ("file", "plans.csv"):
        (folder / name).write_text("a,b\n1,2\n")
    (folder / "slips.py").write_text(SLIPS)
    return {name: str(folder / name) for name in ("new", "file", "empty")} | {"csv": str(folder / "plans.csv")}


def all_refusals(folder: Path) -> dict[str, Refusal]:
    """Run all of `WRONG` and `DRY` in one other process, on an empty cache; what became of each by its arguments."""
    places = make_places(folder)
    work = json.dumps([arguments.format(**places) for arguments, _ in (*WRONG, *DRY)])
    done = subprocess.run(
        [sys.executable, "-m", __name__, str(folder / "cache"), str(folder / "new")],
        input=work,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*filter(None, sys.path), str(folder)])},
        capture_output=True,
        text=True,
        check=True,
    )
    found = [Refusal(**row) for row in json.loads(done.stdout.splitlines()[-1])]
    return {arguments: refusal for (arguments, _), refusal in zip((*WRONG, *DRY), found, strict=True)}


def _refused(arguments: str, places: list[Path]) -> Refusal:
    from tests.benchmark.cli.cli_runs import refusal

    heavy, began = _HEAVY & set(sys.modules), time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        try:
            sentence, refused = refusal(*arguments.split()), True
        except AssertionError:
            sentence, refused = printed.getvalue(), False
    seconds = time.perf_counter() - began
    left = [str(path) for place in places for path in (place, *place.rglob("*")) if path.exists()]
    return Refusal(sentence, refused, seconds, left, sorted((_HEAVY & set(sys.modules)) - heavy))


if __name__ == "__main__":
    os.environ["CHALLENGER_BENCH_CACHE"] = sys.argv[1]
    watched = [Path(sys.argv[1]), Path(sys.argv[2])]
    print(json.dumps([asdict(_refused(arguments, watched)) for arguments in json.load(sys.stdin)]))
