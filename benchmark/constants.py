"""Every number that more than one module must agree on: lengths in metres, times in seconds, frequencies in hertz."""

from typing import Final

VERSION: Final = "0.1.0"
"""Of this program."""
KEYFRAME_HZ: Final = 2
"""Annotated samples per second (nuScenes keyframes)."""
FRAME_HZ: Final = 12
"""Camera frames per second (nuScenes sweeps)."""
FRAMES_PER_KEYFRAME: Final = FRAME_HZ // KEYFRAME_HZ

PLAN_STEPS: Final = 6
"""Waypoints of a plan that every plan has and every protocol judges."""
LONGEST_PLAN_STEPS: Final = 16
"""Waypoints that a plan may have at most; records keep them all, protocols judge the first six."""
PLAN_STEP_S: Final = 0.5
"""Time between waypoints; the last one that protocols judge is 3 s ahead."""
PLAN_ERROR_M: Final = (1.04, 0.45)
"""Standard deviations, along and across, of what accurate planners are off after 3 s and at speed."""
FARTHEST_WAYPOINT_M: Final = 1e4
"""A waypoint farther than this is a mistake of units or frame (or of arithmetic), not a plan."""
HORIZON_STEPS: Final = {"1s": 2, "2s": 4, "3s": 6}
"""Number of waypoints up to each reported horizon."""
LONGER_HORIZON_STEPS: Final = {"4s": 8, "5s": 10, "6s": 12}
"""The same for horizons that are reported of plans that reach so far."""

EGO_LENGTH_M: Final = 4.084
EGO_WIDTH_M: Final = 1.85
"""Metric footprint of the recording car: what all four official protocols use."""
EGO_BODY_WIDTH_M: Final = 1.73
EGO_HEIGHT_M: Final = 1.56
"""Body of the recording car (a Renault Zoe) without mirrors."""
EGO_CENTER_FROM_REAR_AXLE_M: Final = 1.39
"""Box centre ahead of the rear axle, which is the origin of ``ego_pose``."""
EGO_WHEELBASE_M: Final = 2.588
"""Of the recording car."""
LIDAR_FROM_REAR_AXLE_M: Final = 0.943713
"""LIDAR_TOP ahead of the rear axle in nuScenes; used where a data set has no lidar calibration."""
EGO_BOX_FROM_LIDAR_M: Final = 0.5
"""Centre of the metric footprint ahead of the lidar origin, along the heading (spec of all four protocols)."""

COMMAND_LATERAL_M: Final = 2.0
"""Lateral displacement of the last valid future waypoint beyond which the command is left or right."""

CAMERA_NAMES: Final = (
    "CAM_FRONT",
    "CAM_FRONT_RIGHT",
    "CAM_FRONT_LEFT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
    "CAM_BACK_RIGHT",
)
LIDAR_NAME: Final = "LIDAR_TOP"

NUSCENES_TABLES: Final = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)

OFFICIAL_LOCATIONS: Final = (
    "boston-seaport",
    "singapore-onenorth",
    "singapore-hollandvillage",
    "singapore-queenstown",
)
"""The only names ``NuScenesMap`` of the devkit accepts."""

MAP_LAYERS: Final = (
    "polygon",
    "line",
    "node",
    "drivable_area",
    "road_segment",
    "road_block",
    "lane",
    "ped_crossing",
    "walkway",
    "stop_line",
    "carpark_area",
    "road_divider",
    "lane_divider",
    "traffic_light",
    "lane_connector",
)
"""Layers of a map-expansion file that are lists of records, in the order of the official files."""

VEHICLE_CATEGORIES: Final = (
    "vehicle.car",
    "vehicle.truck",
    "vehicle.bus.bendy",
    "vehicle.bus.rigid",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.trailer",
    "vehicle.motorcycle",
    "vehicle.bicycle",
)
FOUR_WHEELED_CATEGORIES: Final = VEHICLE_CATEGORIES[:7]

CATEGORIES: Final = (
    "animal",
    "human.pedestrian.adult",
    "human.pedestrian.child",
    "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility",
    "human.pedestrian.police_officer",
    "human.pedestrian.stroller",
    "human.pedestrian.wheelchair",
    "movable_object.barrier",
    "movable_object.debris",
    "movable_object.pushable_pullable",
    "movable_object.trafficcone",
    "static_object.bicycle_rack",
    *sorted(VEHICLE_CATEGORIES),
)
"""The 23 category names of nuScenes v1.0."""
NUMBERED_CATEGORIES: Final = (
    "noise",
    *CATEGORIES,
    "flat.driveable_surface",
    "flat.other",
    "flat.sidewalk",
    "flat.terrain",
    "static.manmade",
    "static.other",
    "static.vegetation",
    "vehicle.ego",
)
"""Rows of the category table since lidarseg, 32: what official code means by the number of a category."""

DETECTION_CLASS_OF_CATEGORY: Final = {
    "vehicle.car": "car",
    "vehicle.truck": "truck",
    "vehicle.construction": "construction_vehicle",
    "vehicle.bus.bendy": "bus",
    "vehicle.bus.rigid": "bus",
    "vehicle.trailer": "trailer",
    "movable_object.barrier": "barrier",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.bicycle": "bicycle",
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.police_officer": "pedestrian",
    "movable_object.trafficcone": "traffic_cone",
}
"""Class of the detection task of nuScenes by category; other categories are not detected."""
DETECTION_CLASSES: Final = tuple(dict.fromkeys(DETECTION_CLASS_OF_CATEGORY.values()))
"""Classes of the detection task of nuScenes, in the order that the table above has them: that of networks' outputs."""
LARGEST_SEED = (1 << 63) - 1
"""Of a command and of a planner; from 0."""
