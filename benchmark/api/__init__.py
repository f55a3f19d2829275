"""What stands behind the public face where several packages are needed; beside `benchmark.cli` the only such place.

Everything is imported inside the functions, so that ``import benchmark`` and ``challenger-bench --help`` answer at once
and a missing extra breaks only what needs it.
"""

from typing import TYPE_CHECKING

from benchmark.api.driving import (
    drive_settings as drive_settings,
    looks_at_images as looks_at_images,
    require_sensor as require_sensor,
)
from benchmark.api.opening import (
    DEFAULT_IMAGE_SIZE as DEFAULT_IMAGE_SIZE,
    OUT as OUT,
    frozen_root as frozen_root,
    known_scenes as known_scenes,
    open_data as open_data,
    open_split as open_split,
    schematic_renderer as schematic_renderer,
    worker_count as worker_count,
    workspace as workspace,
)
from benchmark.api.planners import (
    load_planner as load_planner,
    model_that_runs as model_that_runs,
    planner_under_test as planner_under_test,
)
from benchmark.api.saying import say_once as say_once, tell as tell
from benchmark.api.showing import (
    stale_leaderboard as stale_leaderboard,
    write_leaderboard as write_leaderboard,
    write_sheets as write_sheets,
)
from benchmark.api.verifying import verify as verify

if TYPE_CHECKING:
    # What the public face hands on of other packages.
    from adapters.checkpoints.anchor_files import write_anchors as write_anchors
    from adapters.checkpoints.arrival import fetch_weights as fetch_weights, import_weights as import_weights
    from adapters.checkpoints.listing import known_weights as known_weights
    from adapters.known_planners import known_planners as known_planners
    from adapters.plan_file import plan_file_factory as plan_file_factory
    from adapters.result_files.planner import result_file_factory as result_file_factory
    from adapters.result_files.recognition import recognise as recognise
    from adapters.result_files.samples import samples_of_data as samples_of_data
    from adapters.result_files.writing.formats import write_results as write_results
    from adapters.extensions.training.ego_status import train_ego_status as train_ego_status
    from adapters.extensions.training.planners import (
        PlannerTraining as PlannerTraining,
        judge_again as judge_again,
        train_planner as train_planner,
    )
    from generation.pipeline.ablation import ablate as ablate
    from generation.pipeline.settings import BuildSettings as BuildSettings
    from generation.pipeline.split import build_split as build_split
    from generation.diffusion.bank import write_bank as write_bank
    from generation.extensions.denoiser_training.card import write_model_card as write_model_card
    from generation.extensions.denoiser_training.loop import (
        TrainingConfig as TrainingConfig,
        train_denoiser as train_denoiser,
    )
    from generation.extensions.magicdrive.command import magicdrive_renderer as magicdrive_renderer
    from generation.extensions.magicdrive.condition_pictures import write_condition_pictures as write_condition_pictures
    from generation.render.pictures import write_pictures as write_pictures
    from generation.search.hyperparameters import HyperParameters as HyperParameters
    from generation.search.presets import hyper_parameters as hyper_parameters, trajectory_model as trajectory_model
    from generation.sources.importing import ImportSettings as ImportSettings, import_scenarionet as import_scenarionet
    from generation.sources.mini import TownSettings as TownSettings, build_town as build_town
    from generation.splits.building import build_frozen as build_frozen
    from generation.splits.edited import edited_split as edited_split
    from generation.splits.packaged import frozen_split as frozen_split, packaged_splits as packaged_splits
    from generation.splits.packing import PackageContents as PackageContents, pack_split as pack_split
    from generation.splits.unpacking import read_split_package as read_split_package
    from leaderboard.figures.heat_map import write_heat_map as write_heat_map, write_lift_map as write_lift_map
    from leaderboard.extensions.films.cli import write_drive_films as write_drive_films
    from leaderboard.extensions.films.film import FilmSettings as FilmSettings
    from leaderboard.extensions.films.filming import write_films as write_films
    from leaderboard.extensions.publishing.checking import check_publishable as check_publishable
    from leaderboard.tables.collision import run_tables as run_tables
    from leaderboard.tables.disagreement import disagreement_table as disagreement_table
    from leaderboard.tables.drives import drive_tables as drive_tables
    from leaderboard.tables.loops import loop_tables as loop_tables
    from leaderboard.extensions.quality.tables import quality_tables as quality_tables
    from leaderboard.tables.slices import slice_tables as slice_tables
    from leaderboard.extensions.reproduction.tables import reproduction_table as reproduction_table
    from leaderboard.tables.transfer import (
        agreement_table as agreement_table,
        transfer_matrices as transfer_matrices,
        transfer_table as transfer_table,
    )
