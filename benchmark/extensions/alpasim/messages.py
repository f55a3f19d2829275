"""AlpaSim's messages as run-time descriptors, made from one table: names, numbers and types of fields.

The wire depends on the numbers and types alone; messages have short names of ours where AlpaSim nests them. What comes
in is counted before protobuf sees it, since small bytes can become large objects.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from benchmark.machine.extension import require_extra
from benchmark.untrusted.files import Limits
from benchmark.untrusted.protobuf_messages import require_message

_TABLE: Final = """
Empty
SessionRequestStatus
Quat: w 1 float, x 2 float, y 3 float, z 4 float
Vec3: x 1 float, y 2 float, z 3 float
Pose: vec 1 Vec3, quat 2 Quat
AABB: size_x 1 float, size_y 2 float, size_z 3 float
DynamicState: angular_velocity 1 Vec3, linear_velocity 2 Vec3, linear_acceleration 3 Vec3, angular_acceleration 4 Vec3
PoseAtTime: pose 1 Pose, timestamp_us 2 fixed64
Trajectory: poses 1 *PoseAtTime
ApiVersion: major 1 uint32, minor 2 uint32, patch 3 uint32
VersionId: version_id 1 string, git_hash 2 string, grpc_api_version 3 ApiVersion
AvailableScenesReturn: scene_ids 1 *string

PinholeParam: principal_point_x 1 double, principal_point_y 2 double, focal_length_x 3 double, focal_length_y 4 double,
  radial_coeffs 5 *double, tangential_coeffs 6 *double, thin_prism_coeffs 7 *double
FisheyeParam: principal_point_x 1 double, principal_point_y 2 double, focal_length_x 3 double, focal_length_y 4 double,
  radial_coeffs 5 *double, max_angle 6 double
LinearCde: linear_c 1 double, linear_d 2 double, linear_e 3 double
FthetaParam: principal_point_x 1 double, principal_point_y 2 double, reference_poly 3 enum,
  pixeldist_to_angle_poly 4 *double, angle_to_pixeldist_poly 5 *double, max_angle 6 double, linear_cde 7 LinearCde
WindshieldParam: reference_poly 1 enum, horizontal_poly 2 *double, vertical_poly 3 *double,
  horizontal_poly_inverse 4 *double, vertical_poly_inverse 5 *double
CameraSpec: ftheta_param 2 FthetaParam, opencv_pinhole_param 3 PinholeParam, opencv_fisheye_param 4 FisheyeParam,
  logical_id 5 string, resolution_h 7 uint32, resolution_w 8 uint32, shutter_type 9 enum,
  bivariate_windshield_model_param 10 WindshieldParam
AvailableCamera: intrinsics 1 CameraSpec, rig_to_camera 2 Pose, logical_id 3 string

SessionDebugInfo: scene_id 1 string
VehicleDefinition: available_cameras 3 *AvailableCamera
RolloutSpec: vehicle 1 VehicleDefinition
DriveSessionRequest: session_uuid 1 string, random_seed 2 fixed64, debug_info 4 SessionDebugInfo,
  rollout_spec 5 RolloutSpec
DriveSessionCloseRequest: session_uuid 1 string
CameraImage: frame_start_us 2 fixed64, frame_end_us 3 fixed64, image_bytes 4 bytes, logical_id 5 string
RolloutCameraImage: session_uuid 1 string, camera_image 3 CameraImage
RolloutEgoTrajectory: session_uuid 1 string, trajectory 3 Trajectory, dynamic_states 5 *DynamicState
Route: waypoints 1 *Vec3, timestamp_us 2 fixed64
RouteRequest: session_uuid 1 string, route 3 Route
GroundTruth: trajectory 1 Trajectory, timestamp_us 2 fixed64
GroundTruthRequest: session_uuid 1 string, ground_truth 2 GroundTruth
DriveRequest: session_uuid 1 string, time_now_us 3 fixed64, time_query_us 4 fixed64, renderer_data 5 bytes
DriveDebugInfo: unstructured_debug_info 1 bytes, sampled_trajectories 2 *Trajectory
DriveResponse: trajectory 2 Trajectory, debug_info 3 DriveDebugInfo, terminate_session 4 bool

ObjectTrajectory: aabb 1 AABB, trajectory 2 Trajectory, object_id 3 string, is_static 4 bool, label_class 5 string
ObjectTrajectoryUpdate: object_id 1 string, trajectory 2 Trajectory
TrafficSessionRequest: session_uuid 1 string, scene_id 2 string, random_seed 3 fixed64,
  logged_object_trajectories 4 *ObjectTrajectory, handover_time_us 5 fixed64
TrafficSessionCloseRequest: session_uuid 1 string
TrafficRequest: session_uuid 1 string, time_query_us 2 fixed64, object_trajectory_updates 3 *ObjectTrajectoryUpdate
TrafficReturn: object_trajectory_updates 1 *ObjectTrajectoryUpdate
TrafficModuleMetadata: version_id 1 VersionId, minimum_history_length_us 2 fixed64

SessionMetadata: session_uuid 1 string, scene_id 2 string, batch_size 3 uint32, n_sim_steps 4 uint32,
  start_timestamp_us 5 fixed64, control_timestep_us 6 fixed64, nre_runid 7 string, nre_version 8 string,
  nre_uuid 9 string, render_start_timestamp_us 10 fixed64
ActorAabb: actor_id 1 string, aabb 2 AABB, actor_label 3 string
ActorDefinitions: actor_aabb 1 *ActorAabb
VersionIds: runtime 1 VersionId, egodriver 2 VersionId, sensorsim 3 VersionId, physics 4 VersionId, traffic 5 VersionId,
  controller 6 VersionId, video_model 7 VersionId
RolloutMetadata: session_metadata 1 SessionMetadata, actor_definitions 2 ActorDefinitions, force_gt_duration 3 fixed64,
  version_ids 4 VersionIds, rollout_index 5 uint32, transform_ego_coords_rig_to_aabb 6 Pose,
  ego_rig_recorded_ground_truth_trajectory 7 Trajectory
ActorPose: actor_id 1 string, actor_pose 2 Pose
ActorPoses: timestamp_us 1 fixed64, actor_poses 2 *ActorPose
LogEntry: rollout_metadata 1 RolloutMetadata, actor_poses 2 ActorPoses, render_request 3 Empty,
  driver_request 4 DriveRequest, driver_return 5 DriveResponse, traffic_request 6 TrafficRequest,
  traffic_return 7 TrafficReturn, physics_request 8 Empty, physics_return 9 Empty,
  driver_session_request 10 DriveSessionRequest, driver_camera_image 11 RolloutCameraImage,
  driver_ego_trajectory 12 RolloutEgoTrajectory, traffic_session_request 13 TrafficSessionRequest,
  controller_request 14 Empty, controller_return 15 Empty, egomotion_estimate_error 16 Empty,
  route_request 17 RouteRequest, ground_truth_request 18 GroundTruthRequest, available_cameras_request 19 Empty,
  available_cameras_return 20 Empty, aggregated_render_request 21 Empty, available_ego_masks_request 22 Empty,
  available_ego_masks_return 23 Empty, batch_render_request 30 Empty
"""
"""``*`` is repeated. Parts of the log that no driver and no traffic model sees are unknown fields of an `Empty`."""

METHODS: Final[Mapping[str, tuple[str, str]]] = {
    "/egodriver.EgodriverService/start_session": ("DriveSessionRequest", "SessionRequestStatus"),
    "/egodriver.EgodriverService/close_session": ("DriveSessionCloseRequest", "Empty"),
    "/egodriver.EgodriverService/submit_image_observation": ("RolloutCameraImage", "Empty"),
    "/egodriver.EgodriverService/submit_egomotion_observation": ("RolloutEgoTrajectory", "Empty"),
    "/egodriver.EgodriverService/submit_route": ("RouteRequest", "Empty"),
    "/egodriver.EgodriverService/submit_recording_ground_truth": ("GroundTruthRequest", "Empty"),
    "/egodriver.EgodriverService/drive": ("DriveRequest", "DriveResponse"),
    "/egodriver.EgodriverService/get_version": ("Empty", "VersionId"),
    "/traffic.TrafficService/start_session": ("TrafficSessionRequest", "SessionRequestStatus"),
    "/traffic.TrafficService/close_session": ("TrafficSessionCloseRequest", "Empty"),
    "/traffic.TrafficService/simulate": ("TrafficRequest", "TrafficReturn"),
    "/traffic.TrafficService/get_metadata": ("Empty", "TrafficModuleMetadata"),
    "/traffic.TrafficService/get_available_scenes": ("Empty", "AvailableScenesReturn"),
}
"""Request and answer of each call, by its path."""
EGODRIVER: Final = "/egodriver.EgodriverService/"
TRAFFIC: Final = "/traffic.TrafficService/"
_PACKAGE: Final = "challenger_bench.alpasim"


@cache
def _fields() -> dict[str, list[tuple[str, int, str, bool]]]:
    """Name, number, type and whether it is repeated of each field, by message."""
    table: dict[str, list[tuple[str, int, str, bool]]] = {}
    for line in _TABLE.replace(",\n", ",").splitlines():
        name, _, fields = line.partition(":")
        if name:
            split = [field.split() for field in fields.split(",") if field]
            table[name] = [(field, int(number), kind.lstrip("*"), "*" in kind) for field, number, kind in split]
    return table


@cache
def _classes() -> dict[str, Any]:
    """The message classes, in a pool of their own: other code may have AlpaSim's in protobuf's."""
    require_extra("google.protobuf", "reading AlpaSim's messages", "alpasim")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="challenger_bench/alpasim.proto", package=_PACKAGE, syntax="proto3")
    for name, fields in _fields().items():
        message = file.message_type.add(name=name)
        for field, number, kind, repeated in fields:
            added = message.field.add(name=field, number=number, label=3 if repeated else 1)
            if kind in _fields():
                added.type, added.type_name = added.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
            else:
                # An enumeration is a number on the wire.
                added.type = getattr(added, f"TYPE_{'INT32' if kind == 'enum' else kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in _fields()
    }


@cache
def _inner(name: str) -> dict[int, str]:
    """The messages within a message, by number."""
    return {number: kind for _, number, kind, _ in _fields()[name] if kind in _fields()}


def build_message(name: str, **fields: Any) -> Any:
    """A message of the table, with values of its fields: texts, numbers, messages, or dictionaries of theirs."""
    return _classes()[name](**fields)


def encode_message(message: Any) -> bytes:
    """The bytes, the same for the same values."""
    encoded: bytes = message.SerializeToString(deterministic=True)
    return encoded


def decode_message(name: str, data: bytes, limits: Limits) -> Any:
    """A message of the table; what is no such message, or more than one may be, is a `ValueError` with a sentence.

    Fields that the table does not have are passed over: later versions of AlpaSim have more.
    """
    from google.protobuf.message import DecodeError

    require_message(data, name, _inner, limits)
    try:
        return _classes()[name].FromString(data)
    except (DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(f"it is not a {name}") from error
