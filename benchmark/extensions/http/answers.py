"""Answer of ``/infer``: a trajectory and a model's other outputs, accepted as by NeuroNCAP's own client.

But for empty lists: its client refuses ``[]``, which servers of the forks may answer where nothing was detected (their
lists are optional, of any length); here that is none, like null.
"""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.http.requests import encode_json, parse_body
from benchmark.extensions.http.values import NeuroncapHttpError, parse_numbers, read_member
from benchmark.geometry import Floats
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.untrusted.files import HTTP_ANSWER
from benchmark.waypoints import points_in_ego

_BODY: Final = "the answer"
_AUX: Final = "aux_outputs"
_BOX_COLUMNS: Final = 5


@dataclass(frozen=True, slots=True)
class ModelAnswer:
    """An answer as the wire has it, in the ego frame (x forward, y left of the rear axle) unless told otherwise.

    Attributes:
        trajectory: (N, 2) waypoints 0.5 s apart; accepted are other shapes too, of which `plan` says what is wrong.
        objects: (A, 5) x, y, length, width, yaw.
        classes: Their classes; lists need not agree in length; no reader compares them.
        futures: (A, M, T, 2) metres from each object's present centre, 0.5 s apart.
    """

    trajectory: Floats
    objects: Floats
    classes: tuple[str, ...]
    scores: Floats
    ids: Floats
    futures: Floats

    @classmethod
    def read(cls, body: bytes) -> Self:
        """Read an answer, whose numbers may be NaN; refused where neither NeuroNCAP's client nor a fork would."""
        value = parse_body(body, HTTP_ANSWER, _BODY)
        trajectory = parse_numbers(read_member(value, "trajectory", _BODY), "trajectory")
        aux = read_member(value, _AUX, _BODY)
        if not isinstance(aux, dict):
            raise NeuroncapHttpError(
                f"{_AUX} is {'null' if aux is None else type(aux).__name__}; write {{}} if there are none"
            )
        classes = aux.get("object_classes") or []
        if not isinstance(classes, list) or not all(isinstance(class_name, str) for class_name in classes):
            raise NeuroncapHttpError(f"{_AUX}.object_classes is not a list of strings")
        return cls(
            trajectory=trajectory,
            objects=_read_optional_list(aux, "objects_in_bev", (0, _BOX_COLUMNS)),
            classes=tuple(classes),
            scores=_read_optional_list(aux, "object_scores", (0,)),
            ids=_read_optional_list(aux, "object_ids", (0,)),
            futures=_read_optional_list(aux, "future_trajs", (0, 0, 0, 2)),
        )

    @classmethod
    def of_plan(cls, plan: Plan, lidar_ahead_m: float) -> Self:
        """A plan's first 3 s on the wire, as rear-axle positions; the lidar is ``lidar_ahead_m`` of the rear axle."""
        boxes, futures = _transform_forecasts(plan, lidar_ahead_m)
        nothing = np.empty(0)
        return cls(plan_to_poses(plan, lidar_ahead_m)[:, :2], boxes, (), nothing, nothing, futures)

    def encoded(self) -> bytes:
        """The body; lists that are empty are null, because the client refuses empty ones. `ValueError` for NaN."""
        aux: dict[str, Floats | tuple[str, ...]] = {
            "objects_in_bev": self.objects,
            "object_classes": self.classes,
            "object_scores": self.scores,
            "object_ids": self.ids,
            "future_trajs": self.futures,
        }
        aux_lists = {name: np.asarray(values).tolist() if len(values) else None for name, values in aux.items()}
        return encode_json({"trajectory": self.trajectory.tolist(), _AUX: aux_lists})

    def plan(self, frame: PlanFrame = PlanFrame.EGO) -> Plan:
        """The part of an answer that can be driven; a third column, which the engine hardly uses, is dropped.

        ``frame`` is that of the protocol, or ``lidar``, as forks of VAD answer. Too few or too many waypoints are
        refused.
        """
        columns = self.trajectory.shape[1] if self.trajectory.ndim == 2 else 0
        waypoints = self.trajectory[:, :2].copy() if columns == 3 else self.trajectory
        try:
            return Plan(waypoints, frame, forecasts=self._forecasts())
        except InputError as error:
            raise NeuroncapHttpError(str(error)) from error

    def _forecasts(self) -> Forecasts | None:
        """Forecasts of others, where they can be told: the wire has no probabilities, all modes count alike."""
        agents = len(self.objects)
        if not agents or len(self.futures) != agents or self.futures.shape[2] < PLAN_STEPS or not self.futures.shape[1]:
            return None
        trajectories = self.objects[:, None, None, :2] + self.futures[:, :, :PLAN_STEPS]
        sound = np.isfinite(trajectories).all() and np.isfinite(self.objects).all()
        if not sound or not (self.objects[:, 2:4] > 0.0).all():
            return None
        modes = self.futures.shape[1]
        return Forecasts(self.objects, trajectories, np.full((agents, modes), 1.0 / modes))


def _read_optional_list(aux: dict[str, Any], name: str, shape: tuple[int, ...]) -> Floats:
    """An optional list, none where it is null, absent or empty; 0 in the shape is any length."""
    if aux.get(name) is None or aux[name] == []:
        return np.empty(shape)
    values = parse_numbers(aux[name], f"{_AUX}.{name}")
    wrong = values.ndim != len(shape) or any(
        wanted not in (0, length_given) for wanted, length_given in zip(shape, values.shape, strict=True)
    )
    if wrong:
        wanted_shape = " x ".join("N" if not length else str(length) for length in shape)
        raise NeuroncapHttpError(f"{_AUX}.{name} must be {wanted_shape} numbers, or null if there are none")
    return values


def _transform_forecasts(plan: Plan, lidar_ahead_m: float) -> tuple[Floats, Floats]:
    """(A, 5) boxes and (A, M, 6, 2) ways from their centres, of a plan's forecasts, in the ego frame."""
    forecasts = plan.forecasts
    if forecasts is None or not len(forecasts.boxes):
        return np.empty((0, _BOX_COLUMNS)), np.empty((0, 0, 0, 2))
    boxes = np.array(forecasts.boxes, np.float64)
    ways = np.asarray(forecasts.trajectories, np.float64) - boxes[:, None, None, :2]
    if plan.frame is PlanFrame.LIDAR:
        boxes[:, :2] = points_in_ego(boxes[:, :2], lidar_ahead_m)
        boxes[:, 4] -= np.pi / 2
        ways = np.stack([ways[..., 1], -ways[..., 0]], axis=-1)
    return boxes, ways
