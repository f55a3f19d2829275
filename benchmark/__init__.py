"""The harness, and the Python face of all four packages: every command has its function here (docs/python.md).

Names are looked up when they are asked for, so that ``import benchmark`` answers at once and a missing extra breaks
only what needs it.
"""

from typing import TYPE_CHECKING, Any, Final

from benchmark.constants import VERSION

__version__ = VERSION
_DEFINED_IN: Final = {
    "benchmark.datasets.roots": ["DataSet"],
    "benchmark.machine.workspace": ["Workspace"],
    "benchmark.scene": ["Scene"],
    "benchmark.errors": ["InputError"],
    "benchmark.api": [
        "open_data",
        "open_split",
        "known_scenes",
        "load_planner",
        "schematic_renderer",
        "drive_settings",
        "planner_under_test",
        "write_sheets",
        "write_leaderboard",
        "stale_leaderboard",
        "verify",
    ],
    "generation.render.pictures": ["write_pictures"],
    "generation.extensions.magicdrive.condition_pictures": ["write_condition_pictures"],
    "generation.sources.importing": ["ImportSettings", "import_scenarionet"],
    "generation.sources.mini": ["TownSettings", "build_town"],
    "benchmark.planning": [
        "Planner",
        "PrivilegedPlanner",
        "SceneInfo",
        "Observation",
        "Command",
        "Plan",
        "PlanFrame",
        "Forecasts",
    ],
    "adapters.plan_file": ["plan_file_factory"],
    "adapters.result_files.planner": ["result_file_factory"],
    "adapters.result_files.writing.formats": ["write_results"],
    "benchmark.evaluation": ["evaluate", "EvalSettings"],
    "benchmark.runs.shards": ["Shard"],
    "benchmark.runs.sharded": ["plan_shard", "merge_shards"],
    "benchmark.fairness.splits": ["judge_split"],
    "benchmark.extensions.challenge.scoring": ["ScoreSettings"],
    "benchmark.runs.driving": ["drive_split", "drive_planners", "DriveSettings"],
    "benchmark.runs.rescoring_drives": ["rescore_drives", "rescore_all_drives"],
    "benchmark.records.drives": ["DriveRecord", "load_drives", "find_drives"],
    "leaderboard.tables.drives": ["drive_tables"],
    "benchmark.protocols": ["PROTOCOLS"],
    "benchmark.records.run": ["RunRecord", "load_record", "find_records"],
    "benchmark.records.review": ["Verdict"],
    "benchmark.datasets.reviewed": ["record_verdicts", "scene_tokens"],
    "benchmark.metrics.frames": ["samples_frame"],
    "benchmark.extensions.cards.data_card": ["write_data_card"],
    "benchmark.extensions.cards.records_card": ["write_records_card"],
    "benchmark.extensions.cards.writing": ["CardSettings"],
    "benchmark.extensions.http.cli": ["serve_planner"],
    "benchmark.extensions.infos.exporting": ["InfoSettings", "export_infos"],
    "benchmark.extensions.exchange.exporting": ["export_scenarionet"],
    "benchmark.extensions.exchange.openscenario": ["export_openscenario"],
    "benchmark.runs.rescoring": ["rescore", "rescore_all"],
    "benchmark.extensions.submissions.checking": ["check_submission"],
    "benchmark.extensions.reproduce.reproducing": ["reproduce", "published_numbers", "expected_file", "store_expected"],
    "leaderboard.extensions.reproduction.tables": ["reproduction_table"],
    "benchmark.metrics.transfer": ["transfer"],
    "leaderboard.tables.transfer": ["transfer_matrices", "transfer_table", "agreement_table"],
    "leaderboard.tables.collision": ["run_tables"],
    "leaderboard.tables.slices": ["slice_tables"],
    "leaderboard.extensions.publishing.checking": ["check_publishable"],
    "leaderboard.tables.disagreement": ["disagreement_table"],
    "leaderboard.figures.heat_map": ["write_heat_map", "write_lift_map"],
    "generation.pipeline.settings": ["BuildSettings"],
    "generation.splits.building": ["build_frozen"],
    "generation.splits.packaged": ["frozen_split", "packaged_splits"],
    "generation.splits.edited": ["edited_split"],
    "generation.splits.packing": ["PackageContents", "pack_split"],
    "generation.splits.unpacking": ["read_split_package"],
    "generation.search.hyperparameters": ["HyperParameters"],
    "generation.search.presets": ["hyper_parameters", "trajectory_model"],
    "generation.extensions.magicdrive.command": ["magicdrive_renderer"],
    "generation.pipeline.ablation": ["ablate"],
    "benchmark.scene_pages.writing": ["SheetSettings"],
    "leaderboard.extensions.films.cli": ["write_drive_films"],
    "leaderboard.extensions.films.filming": ["write_films"],
    "leaderboard.extensions.films.film": ["FilmSettings"],
    "benchmark.extensions.quality.measure": ["measure_quality", "QualitySettings"],
    "leaderboard.extensions.quality.tables": ["quality_tables"],
    "generation.extensions.denoiser_training.loop": ["train_denoiser", "TrainingConfig"],
    "generation.extensions.denoiser_training.card": ["write_model_card"],
    "generation.diffusion.bank": ["write_bank"],
    "adapters.extensions.training.planners": ["train_planner", "judge_again", "PlannerTraining"],
    "adapters.extensions.training.ego_status": ["train_ego_status"],
    "adapters.checkpoints.listing": ["known_weights"],
    "adapters.checkpoints.arrival": ["import_weights", "fetch_weights"],
    "adapters.checkpoints.anchor_files": ["write_anchors"],
    "adapters.known_planners": ["known_planners"],
    "benchmark.cli.demonstration": ["demo", "full_demo", "stale_demo"],
}
_RENAMED: Final = {
    "open_results": "adapters.result_files.recognition:recognise",
    "recorded_samples": "adapters.result_files.samples:samples_of_data",
    "data_contents": "benchmark.datasets.contents:contents",
    "data_statistics": "benchmark.datasets.statistics:statistics",
    "challenge_rules": "benchmark.extensions.challenge.rules:read_rules",
    "check_challenge": "benchmark.extensions.challenge.checking:check_entry",
    "score_challenge": "benchmark.extensions.challenge.scoring:score_entries",
    "check_data": "benchmark.datasets.schema.check:check_tables",
    "explain_protocols": "benchmark.extensions.explain.pictures:explain",
    "generate": "generation.pipeline.split:build_split",
    "QualityDefinition": "benchmark.extensions.quality.definition:Definition",
    "doctor": "benchmark.machine.environment:checks",
}
_FACE: Final = {name: f"{module}:{name}" for module, names in _DEFINED_IN.items() for name in names} | _RENAMED
"""Where each name of the face is defined; what comes of other packages has its types from `benchmark.api`."""

if TYPE_CHECKING:
    from benchmark.api import (
        PackageContents as PackageContents,
        edited_split as edited_split,
        read_split_package as read_split_package,
        BuildSettings as BuildSettings,
        FilmSettings as FilmSettings,
        HyperParameters as HyperParameters,
        ImportSettings as ImportSettings,
        PlannerTraining as PlannerTraining,
        TownSettings as TownSettings,
        TrainingConfig as TrainingConfig,
        ablate as ablate,
        agreement_table as agreement_table,
        build_frozen as build_frozen,
        build_town as build_town,
        check_publishable as check_publishable,
        disagreement_table as disagreement_table,
        drive_settings as drive_settings,
        drive_tables as drive_tables,
        fetch_weights as fetch_weights,
        frozen_split as frozen_split,
        build_split as _generate,
        hyper_parameters as hyper_parameters,
        import_scenarionet as import_scenarionet,
        import_weights as import_weights,
        judge_again as judge_again,
        known_scenes as known_scenes,
        known_weights as known_weights,
        load_planner as load_planner,
        known_planners as known_planners,
        magicdrive_renderer as magicdrive_renderer,
        open_data as open_data,
        open_split as open_split,
        pack_split as pack_split,
        packaged_splits as packaged_splits,
        plan_file_factory as plan_file_factory,
        recognise as _open_results,
        result_file_factory as result_file_factory,
        samples_of_data as _recorded_samples,
        write_results as write_results,
        planner_under_test as planner_under_test,
        quality_tables as quality_tables,
        reproduction_table as reproduction_table,
        run_tables as run_tables,
        schematic_renderer as schematic_renderer,
        slice_tables as slice_tables,
        stale_leaderboard as stale_leaderboard,
        train_ego_status as train_ego_status,
        train_planner as train_planner,
        train_denoiser as train_denoiser,
        trajectory_model as trajectory_model,
        transfer_matrices as transfer_matrices,
        transfer_table as transfer_table,
        verify as verify,
        write_drive_films as write_drive_films,
        write_anchors as write_anchors,
        write_bank as write_bank,
        write_condition_pictures as write_condition_pictures,
        write_films as write_films,
        write_heat_map as write_heat_map,
        write_leaderboard as write_leaderboard,
        write_lift_map as write_lift_map,
        write_model_card as write_model_card,
        write_pictures as write_pictures,
        write_sheets as write_sheets,
    )
    from benchmark.extensions.cards.data_card import write_data_card as write_data_card
    from benchmark.extensions.cards.records_card import write_records_card as write_records_card
    from benchmark.extensions.cards.writing import CardSettings as CardSettings
    from benchmark.extensions.challenge.checking import check_entry as _check_challenge
    from benchmark.extensions.challenge.rules import read_rules as _challenge_rules
    from benchmark.extensions.challenge.scoring import ScoreSettings as ScoreSettings, score_entries as _score_challenge
    from benchmark.cli.demonstration import demo as demo, full_demo as full_demo, stale_demo as stale_demo
    from benchmark.datasets.contents import contents as _data_contents
    from benchmark.extensions.exchange.exporting import export_scenarionet as export_scenarionet
    from benchmark.extensions.exchange.openscenario import export_openscenario as export_openscenario
    from benchmark.extensions.http.cli import serve_planner as serve_planner
    from benchmark.extensions.infos.exporting import InfoSettings as InfoSettings, export_infos as export_infos
    from benchmark.datasets.schema.check import check_tables as _check_data
    from benchmark.datasets.reviewed import record_verdicts as record_verdicts, scene_tokens as scene_tokens
    from benchmark.datasets.roots import DataSet as DataSet
    from benchmark.datasets.statistics import statistics as _data_statistics
    from benchmark.errors import InputError as InputError
    from benchmark.evaluation import EvalSettings as EvalSettings, evaluate as evaluate
    from benchmark.fairness.splits import judge_split as judge_split
    from benchmark.machine.environment import checks as _doctor
    from benchmark.machine.workspace import Workspace as Workspace
    from benchmark.metrics.frames import samples_frame as samples_frame
    from benchmark.metrics.transfer import transfer as transfer
    from benchmark.planning import (
        Command as Command,
        Forecasts as Forecasts,
        Observation as Observation,
        Plan as Plan,
        PlanFrame as PlanFrame,
        Planner as Planner,
        PrivilegedPlanner as PrivilegedPlanner,
        SceneInfo as SceneInfo,
    )
    from benchmark.protocols import PROTOCOLS as PROTOCOLS
    from benchmark.extensions.explain.pictures import explain as _explain_protocols
    from benchmark.extensions.quality.definition import Definition as _QualityDefinition
    from benchmark.extensions.quality.measure import (
        QualitySettings as QualitySettings,
        measure_quality as measure_quality,
    )
    from benchmark.records.drives import (
        DriveRecord as DriveRecord,
        find_drives as find_drives,
        load_drives as load_drives,
    )
    from benchmark.records.review import Verdict as Verdict
    from benchmark.records.run import RunRecord as RunRecord, find_records as find_records, load_record as load_record
    from benchmark.runs.driving import (
        DriveSettings as DriveSettings,
        drive_planners as drive_planners,
        drive_split as drive_split,
    )
    from benchmark.extensions.reproduce.reproducing import (
        expected_file as expected_file,
        published_numbers as published_numbers,
        reproduce as reproduce,
        store_expected as store_expected,
    )
    from benchmark.runs.rescoring import rescore as rescore, rescore_all as rescore_all
    from benchmark.runs.rescoring_drives import (
        rescore_all_drives as rescore_all_drives,
        rescore_drives as rescore_drives,
    )
    from benchmark.extensions.submissions.checking import check_submission as check_submission
    from benchmark.runs.shards import Shard as Shard
    from benchmark.scene import Scene as Scene
    from benchmark.runs.sharded import merge_shards as merge_shards, plan_shard as plan_shard
    from benchmark.scene_pages.writing import SheetSettings as SheetSettings

    QualityDefinition = _QualityDefinition
    challenge_rules = _challenge_rules
    check_challenge = _check_challenge
    check_data = _check_data
    data_contents = _data_contents
    data_statistics = _data_statistics
    doctor = _doctor
    explain_protocols = _explain_protocols
    generate = _generate
    open_results = _open_results
    recorded_samples = _recorded_samples
    score_challenge = _score_challenge
else:
    __all__ = ("__version__", *_FACE)

    def __getattr__(name: str) -> Any:
        if name not in _FACE:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from benchmark.errors import InputError
        from benchmark.machine.extension import imported

        try:
            found = imported(_FACE[name])
        except InputError as absent:
            raise AttributeError(f"benchmark.{name}: {absent}") from None
        globals()[name] = found
        return found

    def __dir__() -> list[str]:
        return sorted({*globals(), *_FACE})
