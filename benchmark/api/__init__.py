"""Implementation of the public functions that need several packages; beside `benchmark.cli` the only such place.

Everything is imported inside the functions, so that ``import benchmark`` and ``challenger-bench --help`` answer at once
and a missing extra breaks only what needs it.
"""

from benchmark.api.driving import (
    drive_settings as drive_settings,
    follow_windows as follow_windows,
    uses_images as uses_images,
    require_engine as require_engine,
    require_sensor as require_sensor,
)
from benchmark.api.opening import (
    DEFAULT_IMAGE_SIZE as DEFAULT_IMAGE_SIZE,
    OUT as OUT,
    build_frozen_root as build_frozen_root,
    known_scenes as known_scenes,
    open_data as open_data,
    open_split as open_split,
    schematic_renderer as schematic_renderer,
    worker_count as worker_count,
    workspace as workspace,
)
from benchmark.api.sources import select_matching_options as select_matching_options
from benchmark.api.planners import (
    PlannerSource as PlannerSource,
    load_planner as load_planner,
    find_runnable_model as find_runnable_model,
    measure_traffic as measure_traffic,
    planner_panel as planner_panel,
    planner_under_test as planner_under_test,
    require_device as require_device,
    require_devices as require_devices,
)
from benchmark.api.sources import (
    SourcePreview as SourcePreview,
    DataSource as DataSource,
    estimate_town_bytes as estimate_town_bytes,
)
from benchmark.api.opening import notify_once as notify_once, notify as notify
from benchmark.api.presentation import (
    find_in_extension as find_in_extension,
    stale_leaderboard as stale_leaderboard,
    write_leaderboard as write_leaderboard,
    write_sheets as write_sheets,
)
from benchmark.api.serving import (
    find_serving_protocol as find_serving_protocol,
    serve_planner as serve_planner,
    serve_traffic as serve_traffic,
)
from benchmark.api.verifying import verify as verify
