# The Python face, declared once: where each name is defined. benchmark/__init__.py reads it, and type checkers do.
# `__all__` is shown, by dir() and a star; the other names answer as well.

from adapters.checkpoints.anchor_files import write_anchors as write_anchors
from adapters.checkpoints.loading import fetch_weights as fetch_weights
from adapters.checkpoints.loading import import_weights as import_weights
from adapters.checkpoints.cache import known_weights as known_weights
from adapters.extensions.training.ego_status import train_ego_status as train_ego_status
from adapters.extensions.training.planners import (
    PlannerTraining as PlannerTraining,
)
from adapters.extensions.training.planners import (
    judge_again as judge_again,
)
from adapters.extensions.training.planners import (
    train_planner as train_planner,
)
from adapters.planner_listing import known_planners as known_planners
from adapters.plan_file import plan_file_factory as plan_file_factory
from adapters.result_files.planner import result_file_factory as result_file_factory
from adapters.result_files.recognition import recognise as open_results
from adapters.result_files.samples import read_recorded_samples as recorded_samples
from adapters.result_files.writing.formats import write_results as write_results
from benchmark.api.driving import drive_settings as drive_settings
from benchmark.api.driving import follow_windows as follow_windows
from benchmark.api.opening import (
    known_scenes as known_scenes,
)
from benchmark.api.opening import (
    open_data as open_data,
)
from benchmark.api.opening import (
    open_split as open_split,
)
from benchmark.api.opening import (
    schematic_renderer as schematic_renderer,
)
from benchmark.api.planners import load_planner as load_planner
from benchmark.api.planners import measure_traffic as measure_traffic
from benchmark.api.planners import planner_panel as planner_panel
from benchmark.api.planners import planner_under_test as planner_under_test
from benchmark.api.presentation import (
    stale_leaderboard as stale_leaderboard,
)
from benchmark.api.presentation import (
    write_leaderboard as write_leaderboard,
)
from benchmark.api.presentation import (
    write_sheets as write_sheets,
)
from benchmark.api.verifying import verify as verify
from benchmark.cli.demo import demo as demo
from benchmark.cli.demo import full_demo as full_demo
from benchmark.cli.demo import stale_demo as stale_demo
from benchmark.datasets.contents import contents as data_contents
from benchmark.datasets.split_reviews import record_verdicts as record_verdicts
from benchmark.datasets.split_reviews import scene_tokens as scene_tokens
from benchmark.datasets.roots import DataSet as DataSet
from benchmark.datasets.schema.check import check_tables as check_data
from benchmark.datasets.statistics import statistics as data_statistics
from benchmark.errors import InputError as InputError
from benchmark.evaluation import EvalSettings as EvalSettings
from benchmark.evaluation import evaluate as evaluate
from benchmark.evaluation import plan_shard as plan_shard
from benchmark.extensions.alpasim_table.table import build_alpasim_table as build_alpasim_table
from benchmark.extensions.cards.data_card import write_data_card as write_data_card
from benchmark.extensions.cards.records_card import write_records_card as write_records_card
from benchmark.extensions.cards.writing import CardSettings as CardSettings
from benchmark.extensions.challenge.checking import check_entry as check_challenge
from benchmark.extensions.challenge.rules import read_rules as challenge_rules
from benchmark.extensions.challenge.scoring import ScoreSettings as ScoreSettings
from benchmark.extensions.challenge.scoring import score_entries as score_challenge
from benchmark.extensions.exchange.exporting import export_scenarionet as export_scenarionet
from benchmark.extensions.exchange.borrowed_names import export_nuscenes as export_nuscenes
from benchmark.extensions.exchange.openscenario import export_openscenario as export_openscenario
from benchmark.extensions.explain.pictures import explain as explain_protocols
from benchmark.api.serving import serve_planner as serve_planner, serve_traffic as serve_traffic
from benchmark.extensions.infos.exporting import InfoSettings as InfoSettings
from benchmark.extensions.infos.exporting import export_infos as export_infos
from benchmark.extensions.mcap.exporting import McapContents as McapContents
from benchmark.extensions.mcap.exporting import export_mcap as export_mcap
from benchmark.extensions.quality.definition import QualityDefinition as QualityDefinition
from benchmark.extensions.quality.measure import QualitySettings as QualitySettings
from benchmark.extensions.quality.measure import measure_quality as measure_quality
from benchmark.extensions.reproduce.reproducing import (
    expected_file as expected_file,
)
from benchmark.extensions.reproduce.reproducing import (
    published_numbers as published_numbers,
)
from benchmark.extensions.reproduce.reproducing import (
    reproduce as reproduce,
)
from benchmark.extensions.reproduce.reproducing import (
    store_expected as store_expected,
)
from benchmark.extensions.submissions.checking import check_submission as check_submission
from benchmark.fairness.split_assessment import judge_split as judge_split
from benchmark.machine.environment import checks as doctor
from benchmark.machine.workspace import Workspace as Workspace
from benchmark.metrics.failures import find_failures as find_failures
from benchmark.metrics.frames import samples_frame as samples_frame
from benchmark.metrics.transfer import transfer as transfer
from benchmark.planning import (
    Command as Command,
)
from benchmark.planning import (
    Forecasts as Forecasts,
)
from benchmark.planning import (
    Observation as Observation,
)
from benchmark.planning import (
    Plan as Plan,
)
from benchmark.planning import (
    PlanFrame as PlanFrame,
)
from benchmark.planning import (
    Planner as Planner,
)
from benchmark.planning import (
    PrivilegedPlanner as PrivilegedPlanner,
)
from benchmark.planning import (
    SceneInfo as SceneInfo,
)
from benchmark.protocols import PROTOCOLS as PROTOCOLS
from benchmark.records.drives import DriveRecord as DriveRecord
from benchmark.records.drives import find_drives as find_drives
from benchmark.records.drives import load_drives as load_drives
from benchmark.records.review import Verdict as Verdict
from benchmark.records.run import RunRecord as RunRecord
from benchmark.records.run import find_records as find_records
from benchmark.records.run import load_record as load_record
from benchmark.runs.driving import (
    DriveSettings as DriveSettings,
)
from benchmark.runs.driving import (
    drive_planners as drive_planners,
)
from benchmark.runs.driving import (
    drive_split as drive_split,
)
from benchmark.runs.rescoring import rescore as rescore
from benchmark.runs.rescoring import rescore_all as rescore_all
from benchmark.runs.rescoring_drives import rescore_all_drives as rescore_all_drives
from benchmark.runs.rescoring_drives import rescore_drives as rescore_drives
from benchmark.runs.units import Shard as Shard
from benchmark.scene import Scene as Scene
from benchmark.scene_pages.writing import SheetSettings as SheetSettings
from generation.diffusion.checkpoint import write_bank as write_bank
from generation.extensions.denoiser_training.card import write_model_card as write_model_card
from generation.extensions.denoiser_training.loop import (
    TrainingConfig as TrainingConfig,
)
from generation.extensions.denoiser_training.loop import (
    train_denoiser as train_denoiser,
)
from generation.extensions.logs123d.importing import LogImport as LogImport
from generation.extensions.logs123d.importing import import_123d as import_123d
from generation.extensions.magicdrive.command import build_magicdrive_renderer as magicdrive_renderer
from generation.extensions.magicdrive.condition_pictures import write_condition_pictures as write_condition_pictures
from generation.pipeline.ablation import run_ablation as ablate
from generation.pipeline.settings import BuildSettings as BuildSettings
from generation.pipeline.split import build_split as generate
from generation.render.pictures import write_pictures as write_pictures
from generation.search.hyperparameters import HyperParameters as HyperParameters
from generation.search.presets import build_further_settings as further_settings
from generation.search.presets import build_hyper_parameters as hyper_parameters
from generation.search.presets import build_trajectory_model as trajectory_model
from generation.sources.importing import ImportSettings as ImportSettings
from generation.sources.importing import import_scenarionet as import_scenarionet
from generation.sources.mini import TownSettings as TownSettings
from generation.sources.mini import build_town_data_set as build_town
from generation.splits.building import build_frozen as build_frozen
from generation.splits.edited import build_edited_split as edited_split
from generation.splits.packaged import read_frozen_split as frozen_split
from generation.splits.packaged import list_packaged_splits as packaged_splits
from generation.splits.packing import PackageContents as PackageContents
from generation.splits.packing import pack_split as pack_split
from generation.splits.unpacking import read_split_package as read_split_package
from leaderboard.extensions.ability.cli import fit_abilities as fit_abilities
from leaderboard.extensions.ability.cli import gather_recorded as gather_recorded
from leaderboard.extensions.ability.next_scenes import choose_next_scenes as choose_next_scenes
from leaderboard.extensions.films.cli import write_drive_films as write_drive_films
from leaderboard.extensions.films.film import FilmSettings as FilmSettings
from leaderboard.extensions.films.filming import write_films as write_films
from leaderboard.extensions.publishing.checking import check_publishable as check_publishable
from leaderboard.extensions.quality.tables import quality_tables as quality_tables
from leaderboard.extensions.reproduction.tables import reproduction_table as reproduction_table
from leaderboard.figures.heat_map import write_heat_map as write_heat_map
from leaderboard.figures.heat_map import write_lift_map as write_lift_map
from leaderboard.tables.collision import run_tables as run_tables
from leaderboard.tables.disagreement import disagreement_table as disagreement_table
from leaderboard.tables.drives import drive_tables as drive_tables
from leaderboard.tables.slices import slice_tables as slice_tables
from leaderboard.tables.transfer import (
    agreement_table as agreement_table,
)
from leaderboard.tables.transfer import (
    transfer_matrices as transfer_matrices,
)
from leaderboard.tables.transfer import (
    transfer_table as transfer_table,
)

__version__: str

__all__ = [
    "PROTOCOLS",
    "BuildSettings",
    "Command",
    "DataSet",
    "DriveRecord",
    "DriveSettings",
    "EvalSettings",
    "Forecasts",
    "HyperParameters",
    "ImportSettings",
    "InputError",
    "Observation",
    "Plan",
    "PlanFrame",
    "Planner",
    "PrivilegedPlanner",
    "RunRecord",
    "Scene",
    "SceneInfo",
    "SheetSettings",
    "TownSettings",
    "Workspace",
    "__version__",
    "build_frozen",
    "build_town",
    "demo",
    "drive_planners",
    "drive_settings",
    "drive_split",
    "drive_tables",
    "evaluate",
    "find_drives",
    "find_records",
    "frozen_split",
    "generate",
    "hyper_parameters",
    "import_scenarionet",
    "known_planners",
    "load_drives",
    "load_planner",
    "load_record",
    "open_data",
    "open_results",
    "open_split",
    "packaged_splits",
    "plan_file_factory",
    "planner_under_test",
    "recorded_samples",
    "rescore",
    "result_file_factory",
    "run_tables",
    "samples_frame",
    "schematic_renderer",
    "slice_tables",
    "trajectory_model",
    "transfer_matrices",
    "verify",
    "write_leaderboard",
    "write_results",
    "write_sheets",
]
