"""What is frozen, part by part: the commands that run in a tree, and what of them is compared."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from freezing.tree import Tree, commands_in, without_options

BASELINES = ("constant-velocity", "log-replay", "idm", "ego-status")
MINIATURES = ("uniad-mini", "vad-mini", "sparsedrive-mini", "diffusiondrive-mini")
NUMERICS = ("physics", "scoring", "denoiser", "protocols")
MODELS = {
    "vad-tiny": "vad_tiny",
    "vad-base": "vad_base",
    "uniad": "uniad",
    "sparsedrive": "sparsedrive",
    "diffusiondrive": "diffusiondrive",
    "magicdrive": "magicdrive",
}
"""Models that can be verified, and their folders below ``parity`` of the golden numbers."""
ALLOWED = "data show (may change)"
"""Printed, but no failure: the pictures of ``data show`` are meant to be drawn as films are."""
HELP_MAY_DIFFER = {"generate": ("--keep-rounds", "--no-keep-rounds"), "sheets": ("--rounds",)}
"""Options whose lines of the help are left out: rounds are stored by the search, and only shown by the sheets."""
REFUSALS = (
    ("eval", "--data", "town"),
    ("eval", "--data", "town", "--model", "no-such-planner"),
    ("eval", "--data", "nowhere", "--model", "idm"),
    ("generate", "--split", "test"),
    ("generate", "--data", "town", "--size", "1x1", "--out", "refused"),
    ("generate", "--data", "town", "--set", "no_such=1", "--out", "refused"),
    ("sheets", "--data", "town", "--split", "adv", "--out", "refused"),
    ("transfer", "--out", "refused"),
    ("film", "--to", "refused", "--protocol", "no-such-protocol"),
    ("verify", "model", "--model", "no-such-model"),
    ("data", "info", "nowhere"),
    ("no-such-command",),
)


@dataclass(frozen=True)
class Kind:
    """How much is run.

    Attributes:
        name: quick or whole.
        scenes: Of the town.
        build: Options of ``data build``.
        search: Options of ``generate`` that bound the search.
        alone: Further ones for what one process makes.
        golden: Folder of golden numbers; the built-in ones are used without.
    """

    name: str
    scenes: int
    build: tuple[str, ...]
    search: tuple[str, ...]
    alone: tuple[str, ...]
    golden: Path | None

    @property
    def whole(self) -> bool:
        """Whether all is run."""
        return self.name == "whole"


def kind_of(*, quick: bool, golden: Path | None) -> Kind:
    """The quick or the whole freeze."""
    keyframes = ("--frames", "keyframes")
    if quick:
        search = ("--candidates", "64", "--vehicles", "3", "--per-scene", "1")
        return Kind("quick", 2, keyframes, search, (*keyframes, "--limit", "1"), None)
    return Kind("whole", 4, (), ("--vehicles", "8"), keyframes, golden)


def data(tree: Tree, kind: Kind) -> None:
    """The embedded data set."""
    tree.remove("town")
    build = ("data", "build", "--town-scenes", str(kind.scenes), *kind.build, "--root", "town", "--workers", "2")
    tree.print("embedded data set", *build)
    tree.files("embedded data set", "town")


def generate(tree: Tree, kind: Kind) -> None:
    """Splits adv and val-r, made by one and by two processes."""
    # The whole freeze draws every twelfth of a second once, with two processes.
    drawn = {1: kind.alone, 2: kind.build}
    keeps = "--keep-rounds" in tree.run("generate", "--help")
    for workers in (2, 1):
        out = f"out{workers}"
        tree.remove(out)
        for split in ("adv", "val-r"):
            thing = f"generate {split}, workers {workers}"
            where = ("--data", "town", "--out", out, "--split", split, "--workers", str(workers))
            stored = ("--keep-rounds",) if keeps and split == "adv" and workers == 2 else ()
            report = tree.run("generate", *where, *kind.search, *drawn[workers], *stored, "--json")
            tree.note(thing, "printed report", report)
            # The rounds that the search stores are compared as what `sheets --rounds` makes of them.
            tree.files(thing, f"{out}/data/town/{split}", lambda path: "rounds" not in path)


def sheets(tree: Tree, kind: Kind) -> None:
    """Scene sheets, and the rounds of refinement in them."""
    tree.remove("out2/sheets")
    where = ("--data", "town", "--out", "out2", "--workers", "2", "--json")
    for split in ("adv", "val", "val-r") if kind.whole else ("adv", "val"):
        rounds = ("--rounds",) if split == "adv" else ()
        tree.note("sheets", f"printed of {split}", tree.run("sheets", *where, "--split", split, *rounds))
    tree.files("rounds of refinement", "out2/sheets", lambda path: path.endswith("/rounds.json"))
    tree.files("sheets", "out2/sheets", lambda path: Path(path).name not in ("rounds.json", "split.json"))
    for path in sorted((tree.work / "out2/sheets").rglob("split.json")):
        found = json.loads(path.read_text())
        if found.get("runtime"):
            # Seconds that generating took; which stages there are is compared.
            found["runtime"]["total_s"] = sorted(found["runtime"]["total_s"])
        tree.note("sheets", path.relative_to(tree.work).as_posix(), json.dumps(found))


def runs(tree: Tree, kind: Kind) -> None:
    """Samples and summaries of all planners that need no foreign weights."""
    tree.remove("out2/runs")
    every = (*BASELINES, *MINIATURES)
    few = ("constant-velocity", "uniad-mini")
    planners = {"adv": every, "val": every if kind.whole else few} | ({"val-r": every} if kind.whole else {})
    for split, names in planners.items():
        models = [word for name in names for word in ("--model", name)]
        where = ("--data", "town", "--out", "out2", "--split", split, "--workers", "2", "--json")
        tree.note("runs, printed", split, tree.run("eval", *where, *models))
    # run.json holds identities of code and machine, rows/ is keyed by them, timing.json holds seconds.
    tree.files("runs", "out2/runs", lambda path: Path(path).name in ("samples.jsonl", "summary.json"))


def reads(tree: Tree, kind: Kind) -> None:
    """What is read from runs and data sets; the start's records are judged anew by either tree."""
    for protocol in ("exact", "native"):
        matrices = json.loads(tree.run("transfer", "--out", "out2", "--protocol", protocol, "--json"))
        # Records are named by their content, identities of code included.
        found = {
            name: {what: value for what, value in matrix.items() if what != "records"}
            for name, matrix in matrices.items()
        }
        tree.note("transfer", f"under {protocol}", json.dumps(found))
    roots = ("town", "out2/data/town/adv", "out2/data/town/val-r")
    for what in ("info", "stats", "check"):
        for root in roots if kind.whole or what == "info" else roots[:2]:
            tree.print(f"data {what}", "data", what, root, "--json", codes=(0, 1))
    tree.copy_of_start("out2/runs", "judged-anew")
    where = ("--data", "town", "--out", "out2", "--json")
    tree.print("rescore, the start's records", "rescore", "--records", "judged-anew", *where, codes=(0, 1))
    tree.files("rescore, the start's records", "judged-anew")
    if kind.whole:
        tree.print("rescore, own records", "rescore", *where, codes=(0, 1))
        tree.print("submit-check, the start's records", "leaderboard", "submit-check", "judged-anew", *where)
        tree.run("data", "show", "out2/data/town/adv", "--to", "pictures")
        tree.files(ALLOWED, "pictures")


def help_texts(tree: Tree, kind: Kind) -> None:
    """Help of every command."""
    waiting: list[tuple[str, ...]] = [()]
    while waiting:
        command = waiting.pop(0)
        text = tree.run(*command, "--help")
        waiting += [(*command, name) for name in commands_in(text)]
        may_differ = HELP_MAY_DIFFER.get(" ".join(command))
        tree.note("help", " ".join((*command, "--help")), without_options(text, may_differ) if may_differ else text)


def refusals(tree: Tree, kind: Kind) -> None:
    """The sentences with which commands refuse."""
    for refused in REFUSALS:
        # A sentence names the module of hyper-parameters, which moves.
        said = re.sub(r"generation\.[\w.]*hyperparameters", "the hyper-parameters", tree.refusal(*refused))
        tree.note("refusals", " ".join(refused), said)


def verify(tree: Tree, kind: Kind) -> None:
    """Numerics against golden numbers."""
    for what in NUMERICS:
        golden = ("--golden", str(kind.golden / what)) if kind.golden is not None else ()
        tree.note(f"verify {what}", "printed", tree.run("verify", what, *golden, "--json"))
        if golden:
            tree.note(f"verify {what}", "printed of the built-in set", tree.run("verify", what, "--json"))


def models(tree: Tree, kind: Kind) -> None:
    """Networks against numbers of their official code."""
    if kind.golden is None:
        return
    for name, folder in MODELS.items():
        golden = ("--golden", str(kind.golden / "parity" / folder))
        tree.note(f"verify model {name}", "printed", tree.run("verify", "model", "--model", name, *golden, "--json"))


def leaderboard(tree: Tree, kind: Kind) -> None:
    """Tables, figures, site and a film, from records and sheets that the start's tree wrote."""
    tree.remove("shown")
    for folder in ("runs", "sheets", "ablation") if kind.whole else ("runs", "sheets"):
        tree.copy_of_start(f"out2/{folder}", f"shown/{folder}")
    tree.print("leaderboard", "leaderboard", "--out", "shown", "--json")
    tree.files("leaderboard and site", "shown/leaderboard")
    _without_place_of_the_palette(tree)
    if kind.whole:
        _without_quotes(tree)
    tree.remove("films")
    shown = ("--data", "town", "--out", "shown", "--split", "adv", "--limit", "1", "--model", "uniad-mini")
    short = ("--until", "6", "--fps", "4") if kind.whole else ("--until", "1", "--fps", "2", "--width", "640")
    tree.print("film", "film", "--to", "films", *shown, *short, "--format", "png", "--json")
    if kind.whole:
        tree.print("film", "film", "--to", "films", *shown, *short, "--format", "webp", "--north-up", "--json")
    tree.files("film", "films")


def _without_place_of_the_palette(tree: Tree) -> None:
    """A comment of the site's style says in which module the same colours are; modules may move."""
    for path in (tree.work / "shown/leaderboard").rglob("player_style.js"):
        text = re.sub(r"[\w/]+/palette\.py", "palette.py", path.read_text())
        tree.note("leaderboard and site", path.relative_to(tree.work).as_posix(), text)


def _without_quotes(tree: Tree) -> None:
    """What the paper quotes beside our own ablation may go from our JSON: it is one of its numbers, not of ours."""
    for path in (tree.work / "shown/leaderboard").rglob("*.json"):
        text = path.read_text()
        if '"paper_rate"' in text:
            without = re.sub(r'\s*"paper_rate":\s*[^,}\n]*,?', "", text)
            tree.note("leaderboard and site", path.relative_to(tree.work).as_posix(), without)


def ablate(tree: Tree, kind: Kind) -> None:
    """The paper's ablation; whole freeze only."""
    if not kind.whole:
        return
    tree.remove("out2/ablation")
    limits = ("--limit", "2", "--candidates", "64", "--vehicles", "2", "--workers", "2")
    printed = tree.run("ablate", "--data", "town", "--out", "out2", "--model", "constant-velocity", *limits, "--json")
    # The paper's number may go from our own measurement.
    tree.note("ablation", "printed", re.sub(r'\s*"paper_rate":\s*[^,}\n]*,?', "", printed))


@dataclass(frozen=True)
class Part:
    """A part of the freeze.

    Attributes:
        run: Runs its commands in a tree and notes what is compared.
        needs: Parts whose files in the same tree it reads, or beside whose files it writes.
        of_start: Parts whose files of the start it reads.
    """

    run: Callable[[Tree, Kind], None]
    needs: tuple[str, ...] = ()
    of_start: tuple[str, ...] = ()


PARTS = {
    "data": Part(data),
    "help": Part(help_texts),
    "generate": Part(generate, ("data",)),
    "verify": Part(verify),
    "refusals": Part(refusals, ("data",)),
    "leaderboard": Part(leaderboard, (), ("runs", "sheets", "ablate")),
    "sheets": Part(sheets, ("data", "generate")),
    "runs": Part(runs, ("data", "generate")),
    "reads": Part(reads, ("data", "generate", "runs"), ("runs",)),
    "ablate": Part(ablate, ("data", "generate")),
    "models": Part(models),
}
"""In the order in which they begin, unless they wait for one another."""
