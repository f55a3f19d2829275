"""Broken, misplaced and malicious result files, by name: each is made from a valid one that is written here."""

import gzip
import io
import json
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from adapters.result_files.contract import FileFrame
from adapters.result_files.samples import RecordedSamples, rotate
from adapters.result_files.synthetic import make_synthetic_samples
from adapters.result_files.writing.formats import WRITERS
from adapters.result_files.writing.pickles import PickledTensor, PlansToWrite, write_pickle
from benchmark.geometry import Floats
from benchmark.planning import Plan, PlanFrame
from benchmark.untrusted.files import Category

Content = Any
Change = Callable[[Content], Content]


@dataclass(frozen=True)
class Broken:
    """One kind.

    Attributes:
        name: What is wrong.
        make: Writes it below a folder.
        categories: Why it may be refused.
    """

    name: str
    make: Callable[[Path], Path]
    categories: tuple[Category, ...]


SAMPLES: RecordedSamples = make_synthetic_samples()


def recorded_plans() -> PlansToWrite:
    """Plans as the car drove; past the end of a scene it goes on a little."""
    plans = {}
    for row in range(len(SAMPLES.tokens)):
        way, valid = SAMPLES.future[row], SAMPLES.valid[row]
        last = way[valid][-1] if valid.any() else np.zeros(2)
        more = np.cumsum(~valid)[:, None] * np.array([0.0, 1.0])
        plans[row] = Plan(np.where(valid[:, None], way, last + more), PlanFrame.LIDAR)
    return PlansToWrite(SAMPLES, tuple(dict.fromkeys(SAMPLES.scenes)), plans, 6)


VALID = recorded_plans()


def valid(name: str, folder: Path) -> Path:
    """A valid file of a format."""
    return WRITERS[name](folder / "valid" / name, VALID)


def _trajectories() -> dict[str, Floats]:
    return {token: plan for token, _, plan in VALID.by_token(FileFrame.LIDAR)}


def _bytes(name: str, content: bytes | Callable[[bytes], bytes], *categories: Category, of: str = "uniad") -> Broken:
    def make(folder: Path) -> Path:
        path = folder / "results.pkl"
        path.write_bytes(content if isinstance(content, bytes) else content(valid(of, folder).read_bytes()))
        return path

    return Broken(name, make, categories)


def _plans(name: str, change: Callable[[dict[str, Floats]], Any], *categories: Category) -> Broken:
    """Plans by token, changed."""

    def make(folder: Path) -> Path:
        return write_pickle(folder / "pred_trajs_dict.pkl", change(_trajectories()), 4)

    return Broken(name, make, categories)


def _each(change: Callable[[Floats], Any]) -> Callable[[dict[str, Floats]], Any]:
    return lambda plans: {token: change(plan) for token, plan in plans.items()}


def _first(change: Callable[[Floats], Any]) -> Callable[[dict[str, Floats]], Any]:
    def changed(plans: dict[str, Floats]) -> Any:
        token = list(plans)[3]
        return {**plans, token: change(plans[token])}

    return changed


def _written(name: str, of: str, change: Change, *categories: Category) -> Broken:
    """A pickle of a repository, its content changed before it is written."""

    def make(folder: Path) -> Path:
        def changed(path: Path, value: Any, protocol: int = 2) -> Path:
            return write_pickle(path, change(value), protocol)

        with patch("adapters.result_files.writing.pickles.write_pickle", changed):
            return WRITERS[of](folder, VALID)

    return Broken(name, make, categories)


def _moved(values: Any, places: int) -> list[Any]:
    """Values, each at the place of another one."""
    return [*list(values)[places:], *list(values)[:places]]


def _of_others(plans: dict[str, Any]) -> dict[str, Any]:
    """Each name with what belongs to the same place of another scene."""
    return dict(zip(plans, _moved(plans.values(), 24), strict=True))


def _json(name: str, of: str, change: Callable[[str], str], *categories: Category) -> Broken:
    def make(folder: Path) -> Path:
        path = folder / "results.json"
        path.write_text(change(valid(of, folder).read_text()))
        return path

    return Broken(name, make, categories)


class _Call:
    """Pickles as a call of a function."""

    def __init__(self, function: Any, *arguments: Any, state: Any = None) -> None:
        self.reduced = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self) -> Any:
        return self.reduced


def _tensor(*said: Any) -> bytes:
    """A UniAD entry with a tensor of 12 numbers, of whose place anything is said."""
    from torch._utils import _rebuild_tensor_v2

    from adapters.result_files.writing.pickles import _PickledStorage

    storage = _PickledStorage(np.zeros(12, np.float32))
    plan = _Call(_rebuild_tensor_v2, storage, *said, False, OrderedDict())
    return pickle.dumps({"bbox_results": [{"token": SAMPLES.tokens[0], "planning_traj": plan}]}, 2)


def _inner(body: bytes) -> bytes:
    """The same with anything as the bytes of the storage."""
    from torch._utils import _rebuild_tensor_v2
    from torch.storage import _load_from_bytes

    plan = _Call(_rebuild_tensor_v2, _Call(_load_from_bytes, body), 0, (1,), (1,), False, OrderedDict())
    return pickle.dumps({"bbox_results": [{"token": "a" * 32, "planning_traj": plan}]}, 2)


def _storage_of(count: int) -> bytes:
    from adapters.result_files.writing.pickles import _PickledStorage, _storage_bytes

    whole = _storage_bytes(_PickledStorage(np.zeros(12, np.float32)))
    return whole.replace((12).to_bytes(8, "little"), count.to_bytes(8, "little"))


def _raw(body: bytes, protocol: int = 4) -> bytes:
    return b"\x80" + bytes([protocol]) + body + b"."


def _name(module: bytes, name: bytes) -> bytes:
    return b"\x8c" + bytes([len(module)]) + module + b"\x8c" + bytes([len(name)]) + name + b"\x93"


_CWD = b"cposix\ngetcwd\n)R"
_MEMO = b"]" + b"".join(b"q" + bytes([level]) + b"](" + (b"h" + bytes([level])) * 10 + b"e" for level in range(40))


def _zipped(content: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("data.pkl", content)
    return made.getvalue()


HOSTILE = (
    _bytes("a foreign class", _raw(b"cacme.results\nPlannerOutput\n)\x81", 2), "class"),
    _bytes("a call while loading", _raw(b"]" + _CWD + b"a", 2), "class"),
    _bytes("a call in the old text protocol", b"(lp0\ncposix\ngetcwd\n(tRa.", "unknown", "class"),
    _bytes("a call hidden in a tensor's bytes", lambda _: _inner(_raw(b"cposix\ngetcwd\n)R", 2)), "class"),
    _bytes("a zip archive in a tensor's bytes", lambda _: _inner(_zipped(b"x")), "class"),
    _bytes("a tensor's bytes cut off", lambda _: _inner(_storage_of(12)[:40]), "truncated", "size", "unknown"),
    _bytes("an attribute of an allowed name", _raw(_name(b"numpy", b"ndarray.tofile")), "class"),
    _bytes("a state for an allowed function", _raw(_name(b"_codecs", b"encode") + b"}\x8c\x01aK\x01sb"), "class"),
    _bytes("an allowed function as a value", _raw(b"]" + _name(b"_codecs", b"encode") + b"a"), "class"),
    _bytes("an array's class called", _raw(_name(b"numpy", b"ndarray") + b"K\x05\x85R"), "class"),
    _bytes("a persistent id", _raw(b"]K\x01Qa"), "class"),
    _bytes("a sparse tensor", _raw(_name(b"torch._utils", b"_rebuild_sparse_tensor") + b")R"), "class"),
    _bytes("an array of objects", lambda _: pickle.dumps({"a" * 32: np.array([None])}, 4), "class"),
    _bytes("an array of records", lambda _: pickle.dumps({"a": np.zeros(2, "i4,f4")}, 4), "class"),
    _bytes("another codec", _raw(_name(b"_codecs", b"encode") + b"\x8c\x01a\x8c\x05rot13\x86R"), "class"),
    _bytes(
        "an array before any data",
        _raw(_name(b"numpy.core.multiarray", b"_reconstruct") + _name(b"numpy", b"ndarray")
             + b"\x8a\x06\x00\x00\x00\x00\x00\x10\x85C\x01b\x87R"),
        "size", "class",
    ),
    _bytes("a tensor beyond its storage", lambda _: _tensor(7, (1, 6, 2), (12, 2, 1)), "size"),
    _bytes("a tensor of 10^12 numbers", lambda _: _tensor(0, (10**6, 10**6), (0, 0)), "size"),
    _bytes("a storage that declares more", lambda _: _inner(_storage_of(1 << 40)), "size"),
    _bytes("lists nested 10^5 deep", _raw(b"]" * 100_000 + b"a" * 99_999), "nesting"),
    _bytes("a value that unfolds to 10^40", _raw(_MEMO, 2), "size"),
    _bytes("a value that unfolds to 2^900", _raw(b")" + b"2\x86" * 900), "size"),
    _bytes("a container within itself", _raw(b"]q\0h\0a", 2), "nesting"),
    _bytes("half of a pickle", lambda data: data[: len(data) // 2], "truncated", "unknown"),
    _bytes("bytes behind the end", lambda data: data + b"x", "trailing"),
    _bytes("nothing", b"", "empty", "truncated"),
    _bytes("a zip archive", lambda data: _zipped(data), "unknown"),
    _bytes("a zip archive cut off", lambda data: _zipped(data)[:500], "unknown", "truncated"),
    _bytes("gzip", lambda data: gzip.compress(data), "unknown"),
    _bytes("a web page", b"<!DOCTYPE html><html></html>", "unknown"),
    _bytes("a table", b"sample_token,frame,x1\na,lidar,0\n", "unknown"),
    _bytes("a number", _raw(b"K\x01"), "unknown"),
)  # fmt: skip
"""Refused by their bytes alone, whatever the data."""
MISPLACED = (
    _plans("no entries", lambda _: {}, "empty"),
    _plans("a token of other data", lambda plans: {**plans, "f" * 32: next(iter(plans.values()))}, "token"),
    _plans("numbers for tokens", lambda plans: dict(enumerate(plans.values())), "token"),
    _plans("five waypoints", _first(lambda plan: plan[:5]), "shape"),
    _plans("a row for now", _each(lambda plan: np.concatenate([[[0.0, 0.0]], plan])), "shape"),
    _plans("numbers as texts", _each(lambda plan: [[str(x), str(y)] for x, y in plan.tolist()]), "shape"),
    _plans("NaN", _first(lambda plan: plan * np.nan), "not_finite"),
    _plans("infinity", _first(lambda plan: plan + np.inf), "not_finite"),
    _plans("centimetres", _each(lambda plan: 100.0 * plan), "unit"),
    _plans("millimetres", _each(lambda plan: 1000.0 * plan), "unit"),
    _plans("offsets for positions", _each(lambda plan: np.diff(plan, axis=0, prepend=0.0)), "offsets", "unit"),
    _plans("swapped axes", _each(lambda plan: plan[:, ::-1]), "frame"),
    _plans("axes of the ego pose", _each(lambda plan: rotate(plan, -np.pi / 2)), "frame"),
    _plans("turned about", _each(lambda plan: -plan), "frame"),
    _plans("mirrored", _each(lambda plan: plan * [-1.0, 1.0]), "frame"),
    _plans("one step late", _each(lambda plan: np.concatenate([np.zeros((1, 2)), plan[:-1]])), "time"),
    _plans("points at 10 Hz", _each(lambda plan: np.outer(np.arange(1, 7) / 5, plan[0])), "time"),
    _plans("measured from the rear axle", _each(lambda plan: plan + [0.0, 0.943713]), "origin", "frame"),
    _written("a sample twice", "uniad", lambda file: {"bbox_results": [*file["bbox_results"], file["bbox_results"][0]]},
             "duplicate"),
    _written("recorded futures of others", "uniad", lambda file: {"bbox_results": [
        {**entry, "planning_traj_gt": other["planning_traj_gt"]}
        for entry, other in zip(file["bbox_results"], _moved(file["bbox_results"], 40))]}, "order"),
    _written("UniAD without plans", "uniad", lambda file: {"bbox_results": [
        {"token": entry["token"], "command": entry["command"]} for entry in file["bbox_results"]]}, "no_plan"),
    _written("no samples", "uniad", lambda _: {"bbox_results": []}, "empty", "count"),
    _written("commands of others", "vad-results", lambda file: {
        **file, "plan_results": _of_others(file["plan_results"])}, "order"),
    _written("no command", "vad-results", lambda file: {**file, "plan_results": {
        token: [plan, PickledTensor(np.zeros((1, 1, 1, 3)))] for token, (plan, _) in file["plan_results"].items()}},
        "shape", "order"),
    _written("moved by one place", "vad-out", lambda file: [*file[1:], file[0]], "order"),
    _written("shuffled", "vad-out", lambda file: file[::-1], "order"),
    _written("metrics only", "vad-out", lambda file: [{"metric_results": entry["metric_results"]} for entry in file],
             "no_plan", "unknown"),
    _written("an entry too few", "sparsedrive", lambda file: file[:-1], "count"),
    _written("an entry too many", "sparsedrive", lambda file: [*file, file[-1]], "count"),
    _written("moved by a scene", "sparsedrive", lambda file: [*file[24:], *file[:24]], "order"),
    _written("dumped after its metric", "sparsedrive", lambda file: [
        {"img_bbox": {**entry["img_bbox"], "final_planning": PickledTensor(
            VALID.waypoints(int(SAMPLES.by_time[at]), FileFrame.LIDAR) * [-1.0, 1.0])}}
        for at, entry in enumerate(file)], "frame"),
    _written("boxes only", "sparsedrive", lambda file: [{"img_bbox": {"boxes_3d": None}} for _ in file], "no_plan"),
    _written("plans of two lengths", "sparsedrive", lambda file: [
        {"img_bbox": {"final_planning": np.zeros((12 if at == 5 else 6, 2))}} for at in range(len(file))], "shape"),
    _written("poses of others", "bev-planner", lambda file: [
        {**entry, "pred_ego_traj": {**entry["pred_ego_traj"], "ego_trajs_in_global": PickledTensor(np.zeros((7, 2)))}}
        for entry in file], "order"),
    _written("an index beyond all samples", "bev-planner", lambda file: [
        {**entry, "index": 5000, "pred_ego_traj": {**entry["pred_ego_traj"], "index": 5000,
                                                   "index_w_scene": "scene-0001-5000"}} for entry in file], "count"),
    _written("two plans of a sample", "bev-planner", lambda file: [
        *file, {**file[0], "pred_ego_traj": {**file[0]["pred_ego_traj"],
                                             "pred_ego_fut_trajs": PickledTensor(np.ones((6, 2)))}}], "duplicate"),
    _json("a way of another sample", "bev-planner-json", lambda text: json.dumps(
        {**json.loads(text), "trajs": _of_others(json.loads(text)["trajs"])}), "order"),
    _json("a token twice", "opendrivevla", lambda text: text.replace(SAMPLES.tokens[1], SAMPLES.tokens[0]),
          "duplicate"),
    _json("NaN in JSON", "opendrivevla", lambda text: text.replace("0.0", "NaN", 1), "not_finite"),
    _json("a number beyond all", "opendrivevla", lambda text: text.replace("0.0", "1e999", 1), "not_finite"),
    _json("true for a number", "opendrivevla", lambda text: text.replace("0.0", "true", 1), "shape"),
    _json("half of JSON", "opendrivevla", lambda text: text[: len(text) // 2], "truncated"),
    _json("text behind the end of JSON", "opendrivevla", lambda text: text + "{}", "trailing"),
    _json("JSON nested 10^5 deep", "opendrivevla", lambda _: "[" * 100_000 + "]" * 100_000, "nesting"),
    _json("detections", "opendrivevla", lambda _: json.dumps({"meta": {}, "results": {"a": []}}), "no_plan"),
    _json("other JSON", "opendrivevla", lambda _: '{"a": 1}', "unknown"),
    _json("a line without an answer", "opendrivevla-conversation", lambda text: text.replace('"answer"', '"reply"', 2)
          .replace('"reply"', '"answer"', 1), "shape"),
    _json("answers without plans", "opendrivevla-conversation", lambda text: text.replace("(", "").replace(")", ""),
          "no_plan"),
)  # fmt: skip
"""Refused because of what the data say, or of what is in them."""


def _folder(name: str, change: Callable[[Path], object], *categories: Category) -> Broken:
    def make(folder: Path) -> Path:
        target = valid("omnidrive", folder)
        change(target)
        return target

    return Broken(name, make, categories)


def _emptied(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()


FOLDERS = (
    _folder("a stray file in the folder", lambda folder: (folder / "notes.txt").write_text("x"), "unknown"),
    _folder("an empty folder", _emptied, "empty"),
    _folder(
        "an answer cut off", lambda folder: next(iter(sorted(folder.iterdir()))).write_text('[{"Q": '), "truncated"
    ),
    _folder("an empty answer", lambda folder: next(iter(sorted(folder.iterdir()))).write_text(""), "truncated"),
    _folder(
        "an answer of other data", lambda folder: (folder / ("f" * 32)).write_text('[{"Q": "", "A": [""]}]'), "token"
    ),
    _folder("an answer that is none", lambda folder: next(iter(sorted(folder.iterdir()))).write_text("[1]"), "shape"),
)
BROKEN = (*HOSTILE, *MISPLACED, *FOLDERS)
