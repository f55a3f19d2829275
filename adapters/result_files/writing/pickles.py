"""Pickles of UniAD, VAD, SparseDrive, BEV-Planner, Agent-Driver and AD-MLP from a run record, always the same bytes."""

import io
import pickle
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adapters.result_files.contract import LONG_PLAN_STEPS, FileFrame, Rows
from adapters.result_files.frames import file_waypoints
from adapters.result_files.samples import RecordedSamples, rotate
from adapters.result_files.uniad import MIRRORED
from adapters.result_files.vad import COMMANDS
from benchmark.constants import HORIZON_STEPS, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import write_bytes
from benchmark.planning import Plan, PlanFrame
from benchmark.records.run import RunRecord
from benchmark.untrusted.legacy_storages import FORMAT, MAGIC, STORAGES
from benchmark.waypoints import chord_headings

_PROTOCOL: Final = 2
"""Pickle protocol of mmcv."""
_SYSTEM: Final = {
    "protocol_version": FORMAT,
    "little_endian": True,
    "type_sizes": {"short": 2, "int": 4, "long": 4},
}
_CLASS_OF: Final = {kind: name for name, kind in STORAGES.items() if name != "BFloat16Storage"}


class PickledTensor:
    """An array that is pickled as the tensor of the same numbers; single precision unless `kind` names a type."""

    def __init__(self, values: ArrayLike, kind: str = "<f4") -> None:
        self._values: NDArray[Any] = np.ascontiguousarray(values, kind)

    def __reduce__(self) -> tuple[Any, ...]:
        from torch._utils import _rebuild_tensor_v2

        values = self._values
        strides = tuple(step // values.itemsize for step in values.strides)
        return _rebuild_tensor_v2, (_PickledStorage(values), 0, values.shape, strides, False, OrderedDict())


class _PickledStorage:
    """The numbers of a tensor, pickled as PyTorch's storages are."""

    def __init__(self, values: NDArray[Any]) -> None:
        self.values = values

    def __reduce__(self) -> tuple[Any, ...]:
        """The bytes of a file in PyTorch's old form, as its storages reduce."""
        from torch.storage import _load_from_bytes

        return _load_from_bytes, (_storage_bytes(self),)


class _StoragePickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> Any:
        """Tuple that stands for the storage."""
        if not isinstance(obj, _PickledStorage):
            return None
        import torch

        kind = getattr(torch, _CLASS_OF[obj.values.dtype.str])
        return ("storage", kind, "0", "cpu", obj.values.size, None)


def _storage_bytes(storage: _PickledStorage) -> bytes:
    stream = io.BytesIO()
    for value in (MAGIC, FORMAT, _SYSTEM):
        pickle.dump(value, stream, _PROTOCOL)
    _StoragePickler(stream, _PROTOCOL).dump(storage)
    pickle.dump(["0"], stream, _PROTOCOL)
    stream.write(storage.values.size.to_bytes(8, "little"))
    stream.write(storage.values.tobytes())
    return stream.getvalue()


def write_pickle(path: Path, value: Any, protocol: int = _PROTOCOL) -> Path:
    """Write a pickle of plain values, arrays and `PickledTensor`."""
    write_bytes(path, pickle.dumps(value, protocol))
    return path


@dataclass(frozen=True)
class PlansToWrite:
    """Plans to be written, by row and in the order of rows; all have the same `steps`, waypoints."""

    samples: RecordedSamples
    scenes: tuple[str, ...]
    plans: dict[int, Plan]
    steps: int

    @classmethod
    def of_record(cls, record: RunRecord, samples: RecordedSamples) -> "PlansToWrite":
        """The plans of a record; one without any is an `InputError`."""
        plans = {
            samples.row_of[row.sample_token]: Plan(np.array(row.plan.waypoints), PlanFrame(row.plan.frame))
            for row in record.rows
            if row.plan is not None
        }
        if not plans:
            raise InputError(f"{record.directory} has no plan to write into a result file; see its failures.txt")
        steps = min(len(plan.waypoints) for plan in plans.values())
        return cls(samples, tuple(record.run.scenes), dict(sorted(plans.items())), steps)

    @cached_property
    def info_rows(self) -> Rows:
        """Rows of the scenes that ran, in the likelier order of an info file that is sorted by time."""
        return self.samples.possible_orders()[0].of_scenes(self.scenes).by_time

    def waypoints(self, row: int, frame: FileFrame, steps: int = PLAN_STEPS) -> Floats:
        """(K, 2) waypoints of a sample in the frame of a file, metres."""
        return file_waypoints(self.plans[row], frame, self.samples.lidar_in_ego[row])[:steps]

    def by_token(self, frame: FileFrame) -> Iterator[tuple[str, int, Floats]]:
        """Token, row and (6, 2) waypoints of each sample that has a plan."""
        for row in self.plans:
            yield self.samples.tokens[row], row, self.waypoints(row, frame)

    def require_all(self, format_name: str) -> None:
        """Refuse to write a file that names no samples where some have no plan."""
        missing = [self.samples.tokens[row] for row in self.info_rows.tolist() if row not in self.plans]
        if missing:
            raise InputError(
                f"a file of the format {format_name} names no samples, so each needs a plan, but {len(missing)} have "
                f"none, the first {missing[0]}; choose another format"
            )


def prepare_path(folder: Path, name: str) -> Path:
    """Path of a file to be written in a folder that exists."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


_MODES: Final = 6
"""Plans of one command in SparseDrive."""
_PYTHON_3: Final = 4
"""Protocol of a pickle that is written without saying which."""


def write_uniad(folder: Path, dumped: PlansToWrite) -> Path:
    """``results.pkl`` of UniAD, x mirrored as its metric leaves it."""
    entries = []
    for token, row, plan in dumped.by_token(FileFrame.LIDAR):
        future = np.zeros((1, 1, PLAN_STEPS, 3))
        future[0, 0, :, :2] = dumped.samples.future[row] * MIRRORED
        entries.append(
            {
                "token": token,
                "planning_traj": PickledTensor([plan * MIRRORED]),
                "planning_traj_gt": [PickledTensor(future)],
                "command": [PickledTensor([dumped.samples.commands[row]], "<i8")],
            }
        )
    return write_pickle(prepare_path(folder, "results.pkl"), {"bbox_results": entries})


def write_vad_results(folder: Path, dumped: PlansToWrite) -> Path:
    """``results_nusc.pkl`` of VAD: offsets for three commands, those of the others zero."""
    plans = {
        token: [PickledTensor(part) for part in _offsets(dumped, row, plan)]
        for token, row, plan in dumped.by_token(FileFrame.LIDAR)
    }
    content = {"meta": {"use_camera": True}, "results": {}, "map_results": {}, "plan_results": plans}
    return write_pickle(prepare_path(folder, "results_nusc.pkl"), content)


def write_vad_out(folder: Path, dumped: PlansToWrite) -> Path:
    """VAD's ``--out``: one entry for each sample, with the displacements that prove their order."""
    dumped.require_all("vad-out")
    entries = []
    for row in dumped.info_rows.tolist():
        plan = dumped.waypoints(row, FileFrame.LIDAR)
        offsets, command = _offsets(dumped, row, plan)
        complete = bool(dumped.samples.complete[row])
        away_m = np.linalg.norm(plan - dumped.samples.future[row], axis=1) if complete else np.zeros(PLAN_STEPS)
        metrics: dict[str, Any] = {f"plan_L2_{name}": float(away_m[:end].mean()) for name, end in HORIZON_STEPS.items()}
        held = {"ego_fut_preds": PickledTensor(offsets), "ego_fut_cmd": PickledTensor(command)}
        entries.append({"pts_bbox": held, "metric_results": {**metrics, "fut_valid_flag": complete}})
    return write_pickle(prepare_path(folder, "out.pkl"), entries)


def write_sparsedrive(folder: Path, dumped: PlansToWrite) -> Path:
    """``results.pkl`` of SparseDrive: the plan as the best one of the command, all other modes zero."""
    dumped.require_all("sparsedrive")
    steps = LONG_PLAN_STEPS if dumped.steps >= LONG_PLAN_STEPS else PLAN_STEPS
    entries = []
    for row in dumped.info_rows.tolist():
        plan, command = dumped.waypoints(row, FileFrame.LIDAR, steps), int(dumped.samples.commands[row])
        modes, scores = np.zeros((COMMANDS, _MODES, steps, 2)), np.zeros((COMMANDS, _MODES))
        modes[command, 0], scores[command, 0] = plan, 1.0
        held = {"planning_score": scores, "planning": modes, "final_planning": plan}
        entries.append({"img_bbox": {name: PickledTensor(values) for name, values in held.items()}})
    return write_pickle(prepare_path(folder, "results.pkl"), entries)


def write_bev_planner(folder: Path, dumped: PlansToWrite) -> Path:
    """BEV-Planner's ``--out``."""
    samples, index_of = dumped.samples, {int(row): index for index, row in enumerate(dumped.samples.by_table)}
    entries = []
    for row in sorted(dumped.plans, key=index_of.__getitem__):
        plan = dumped.waypoints(row, FileFrame.DISPLACEMENT)
        recorded = rotate(samples.future[row], float(samples.lidar_in_ego[row, 2])) * samples.valid[row][:, None]
        held = {
            "pred_ego_fut_trajs": PickledTensor(plan),
            "gt_ego_fut_trajs": PickledTensor(recorded),
            "index_w_scene": f"{samples.scenes[row]}-{index_of[row]}",
            "ego_trajs_in_global": PickledTensor(global_path(dumped, row, plan)),
            "index": index_of[row],
        }
        entries.append({"pred_ego_traj": held, "index": index_of[row]})
    return write_pickle(prepare_path(folder, "out.pkl"), entries)


def global_path(dumped: PlansToWrite, row: int, displacements: Floats) -> Floats:
    """(7, 2) the ego pose, and displacements from it in global axes, single precision."""
    pose = dumped.samples.ego_pose[row]
    way = pose[:2] + rotate(np.concatenate([np.zeros((1, 2)), displacements]), float(pose[2]))
    return np.asarray(way.astype(np.float32), np.float64)


def write_pred_trajs(folder: Path, dumped: PlansToWrite) -> Path:
    """``pred_trajs_dict.pkl`` of Agent-Driver."""
    plans = {token: np.ascontiguousarray(plan) for token, _, plan in dumped.by_token(FileFrame.LIDAR)}
    return write_pickle(prepare_path(folder, "pred_trajs_dict.pkl"), plans, _PYTHON_3)


def write_admlp(folder: Path, dumped: PlansToWrite) -> Path:
    """``output_data.pkl`` of AD-MLP: positions and heading."""
    plans = {}
    for token, _, plan in dumped.by_token(FileFrame.LIDAR):
        heading = chord_headings(plan, start_heading_rad=np.pi / 2) - np.pi / 2
        plans[token] = np.column_stack([plan, heading])[None].astype(np.float32)
    return write_pickle(prepare_path(folder, "output_data.pkl"), plans, 3)


def _offsets(dumped: PlansToWrite, row: int, plan: Floats) -> tuple[Floats, Floats]:
    """Offsets of three commands, and the command as VAD has it."""
    command = int(dumped.samples.commands[row])
    offsets = np.zeros((COMMANDS, PLAN_STEPS, 2))
    offsets[command] = np.diff(plan, axis=0, prepend=np.zeros((1, 2)))
    return offsets, np.eye(COMMANDS)[command].reshape(1, 1, 1, COMMANDS)
