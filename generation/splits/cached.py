"""The newest frozen split of the embedded data set, built into the user's cache; its scenes' names without building."""

from collections.abc import Callable
from pathlib import Path

from benchmark.datasets.roots import DataSet
from benchmark.datasets.statistics import list_scenes
from benchmark.machine.storage import content_key
from benchmark.machine.workspace import cache_root, is_finished
from benchmark.records.scene_assessment import DEFINITION
from generation.render.contract import Renderer
from generation.splits.packaged import read_newest_split


def build_cached_root(source: DataSet, renderer: Renderer, workers: int, say: Callable[[str], None]) -> Path:
    """Root of the newest frozen split; built where it is not finished, key frames only. ``say`` is told of it."""
    from benchmark.machine.workers import LocalProcesses
    from generation.pipeline.settings import BuildSettings
    from generation.splits.building import build_frozen

    newest = read_newest_split(source.name)
    made_of = content_key(newest.frozen.content_id, source.fingerprint(), renderer.name, renderer.version, DEFINITION)
    root = cache_root() / f"{newest.name}-{made_of[:12]}"
    if is_finished(root):
        say(f"split adv of {source.name} is the frozen split {newest.name}; generate --split adv starts a new search")
        return root
    say(f"building the frozen split {newest.name} in {root} (once, about a minute)")
    settings = BuildSettings(out=root, renderer=renderer, frames="keyframes", executor=LocalProcesses(workers))
    say(build_frozen(source, newest, settings).summary())
    return root


def list_scene_names(data: str, split: str, root: Path) -> tuple[str, ...]:
    """Names of a generated split's scenes, in its order, from a finished root or else from the newest frozen split."""
    if is_finished(root):
        return list_scenes(root, split)
    return tuple(sorted(scene.name for scene in read_newest_split(data, split).frozen.scenes))
