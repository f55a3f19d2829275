"""Implementation of ``drive``: engines and agents of `benchmark`, cameras of `generation`, planners of `adapters`."""

from typing import TYPE_CHECKING

from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from benchmark.closed_loop.adversary import AdversaryFactory
    from benchmark.closed_loop.observation_builder import Sensor
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workers import Executor
    from benchmark.records.encounter_window import WindowName
    from benchmark.runs.driving import DriveSettings


def uses_images(name: str) -> bool | None:
    """Whether a planner uses images: built-in ones declare it, HTTP carries some, others are unknown (``None``)."""
    from adapters.models import MODELS
    from benchmark.machine.address import is_address

    if is_address(name):
        return True
    return not MODELS[name].blind if name in MODELS else None


def drive_settings(
    split: str,
    *,
    engine: str = "default",
    agents: str | None = None,
    window: "WindowName | None" = None,
    adversary_knows: str = "motion",
    adversary_every_s: float = 1.0,
    adversary_others: str = "replay",
    adversary_rounds: int | None = None,
    adversary_candidates: int | None = None,
    adversary_tracks: "Path | None" = None,
    keep_considered: bool = False,
    ladder: "Sequence[str] | None" = None,
    sensor: str = "none",
    accept_torch_tensors: bool = False,
    latency_ms: int = 0,
    scenarios: str = "recorded",
    target: str = "adversary",
    until: str = "contact",
    runs: int = 1,
    scenes: "Sequence[str] | None" = None,
    limit: int | None = None,
    executor: "Executor | None" = None,
    timeout_s: float = 120.0,
    plan_hz: int = 2,
    seed: int = 0,
    adversarial: bool | None = None,
) -> "DriveSettings":
    """How planners are driven, for `benchmark.drive_split` (docs/closed-loop.md).

    Args:
        split: The split; generated ones have pictures in a style of their own.
        engine: ``default``, ``neuroncap@code`` or ``neuroncap@paper``, with departures as its switches are named.
        agents: ``replay``, ``idm``, or ``adversary``, which the search of open loop plans anew while the ego drives
            (docs/extensions/reactive_adversary.md), or ``grpc://HOST:PORT``, a TrafficService
            (docs/extensions/alpasim.md); NeuroNCAP's never react. By default ``idm`` on ``adv``, where
            adversaries keep their tracks, else ``replay``.
        window: ``encounter`` drives adversarial scenes from 3 s before their adversaries depart until these are gone,
            ``scene`` drives all of them. ``encounter`` by default on ``adv`` in the default engine, unless the agents
            are ``adversary``.
        adversary_knows: What it expects of the ego: ``plan``, ``motion`` (that it keeps its speed on its route),
            ``motion-only`` (that it keeps its speed and its turn), or ``nothing``.
        adversary_every_s: Seconds between its plans.
        adversary_others: All other agents beside an adversary: ``replay`` or ``idm``.
        adversary_rounds: Refinement rounds of its search; those of open loop by default.
        adversary_candidates: Candidates of each round; those of open loop by default.
        adversary_tracks: A record of drives against an adversary: its tracks are driven again, and nothing is planned.
        keep_considered: Keep what the adversary considered at each of its plans beside the record, for films and site.
        ladder: Reference drivers that drive every encounter with an adversary too; all by default.
        sensor: ``none``, ``schematic``, or the address of a renderer's server (docs/extensions/http.md).
        accept_torch_tensors: Whether a renderer's pictures may be saved tensors, which are pickles.
        latency_ms: So much later does a plan take effect; a multiple of 100, 0 in NeuroNCAP's engine.
        scenarios: In NeuroNCAP's engine: scenes as they are (``recorded``), with ``own`` or ``official`` scenarios, or
            with that of a scenario file of NeuroNCAP (``FILE.yaml``).
        target: Of recorded scenes in NeuroNCAP's engine: whose velocity the reference speed of the score is relative
            to, that of the scene's ``adversary``, or ``none``, as NeuroNCAP has it without a scenario.
        until: What ends a drive before its time: ``contact``, any; ``fault``, one that is the ego's fault by our rule
            (docs/fault.md), ``fault@nuplan`` by nuPlan's, and another object that touches it otherwise is gone from the
            next planning instant on. NeuroNCAP's engine ends at any.
        runs: Runs of each scene; one where nothing is drawn.
        scenes: Only these scenes.
        limit: Only the first so many.
        executor: Where drives are made; this process by default.
        timeout_s: How long a plan may take.
        plan_hz: How often planners are asked in a second: 2, as nuScenes' are trained, or 10, in the default engine.
        seed: Of the intervals.
        adversarial: Whether scenes have adversaries; by the split's name by default.

    Returns:
        The settings.

    Raises:
        InputError: If there is no such engine, policy or sensor, or they do not go together.
    """
    from benchmark.closed_loop.adversary import ADVERSARY
    from benchmark.closed_loop.engines import is_scenario_file, make_backend
    from benchmark.closed_loop.world_state import ENGINE
    from benchmark.interactions.driver_simulation import REFERENCE_DRIVER_KINDS
    from benchmark.machine.address import is_address
    from benchmark.machine.extension import import_from_extension
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.drive_schema import OF_FILE
    from benchmark.records.seed_splits import is_adversarial
    from benchmark.runs.driving import DriveSettings

    if plan_hz not in (2, 10) or (plan_hz != 2 and engine != ENGINE):
        raise InputError(f"--plan-hz {plan_hz} needs --engine default, and is 2 or 10; leave it out")
    adversarial = is_adversarial(split) if adversarial is None else adversarial
    remote = agents if agents is not None and is_address(agents) else None
    agents = ADVERSARY if remote is not None else agents
    agents, window = choose_world(engine, agents, window, adversarial=adversarial)
    drivers = [driver.value for driver in REFERENCE_DRIVER_KINDS]
    if ladder is not None and (strange := [name for name in ladder if name not in drivers]):
        raise InputError(f"unknown reference driver {strange[0]!r}; choose from {', '.join(drivers)}")
    if keep_considered and (agents != ADVERSARY or adversary_tracks is not None or remote is not None):
        raise InputError(
            "--keep-considered needs an adversary that plans; add --agents adversary, and leave --adversary-tracks out"
        )
    pursuit: AdversaryFactory | None = None
    if adversary_tracks is not None:
        if agents != ADVERSARY:
            raise InputError("--adversary-tracks needs an adversary; add --agents adversary")
        pursuit, runs = _given_tracks(adversary_tracks, split)
    elif remote is not None and engine == ENGINE:
        pursuit = import_from_extension("agents scheme", "grpc")(remote)
    elif agents == ADVERSARY and engine == ENGINE:
        pursuit = import_from_extension("agents", ADVERSARY)(
            knows=adversary_knows,
            every_s=adversary_every_s,
            others=adversary_others,
            rounds=adversary_rounds,
            candidates=adversary_candidates,
            keep_considered=keep_considered,
        )
    return DriveSettings(
        engine=engine,
        maker=make_backend(engine, agents, latency_ms, scenarios, pursuit, until, describe_target(target)),
        ladder=tuple(drivers if ladder is None else ladder),
        keep_considered=keep_considered,
        agents=agents,
        sensor=_sensor(sensor, split, tensors=accept_torch_tensors),
        runs=runs,
        latency_ms=latency_ms,
        scenarios=OF_FILE if is_scenario_file(scenarios) else scenarios,
        scenes=None if scenes is None else tuple(scenes),
        limit=limit,
        executor=executor or LocalProcesses(),
        timeout_s=timeout_s,
        plan_hz=plan_hz,
        seed=seed,
        window=window,
    )


def choose_world(
    engine: str, agents: str | None, window: "WindowName | None", *, adversarial: bool
) -> "tuple[str, WindowName | None]":
    """Agents and window that are meant, those of adversarial scenes where the scenes are.

    The window is ``None`` where scenes are driven whole and nobody among the agents is special. Raises `InputError` for
    a window that there is not.
    """
    from benchmark.closed_loop.adversary import ADVERSARY
    from benchmark.closed_loop.world_state import ENGINE

    around = adversarial and engine == ENGINE
    agents = agents or ("idm" if around else "replay")
    if window == "encounter" and engine != ENGINE:
        raise InputError(f"{engine} has a start of its own; leave --window encounter out or use --engine {ENGINE}")
    if window == "encounter" and agents == ADVERSARY:
        raise InputError(
            f"the vehicle of --agents {ADVERSARY} departs when the drive begins; leave --window encounter out"
        )
    if window == "encounter" and not adversarial:
        raise InputError("--window encounter is for adversarial scenes; leave it out, or add --split adv")
    if not around or agents == ADVERSARY:
        return agents, None
    # Among replayed tracks a whole scene is driven as it always was.
    return agents, None if (agents, window) == ("replay", "scene") else window or "encounter"


def follow_windows(
    settings: "DriveSettings", split: str, data: "DataSet", unchanged: "DataSet", unchanged_split: str
) -> "DriveSettings":
    """How the recordings of an adversarial split are driven, so that both can be compared: in the same windows.

    Whoever became an adversary keeps its recorded track there, among ``idm`` agents too.

    Args:
        settings: Of the adversarial split.
        split: Its name.
        data: The data set that holds it.
        unchanged: The data set that holds the recordings.
        unchanged_split: Their split.

    Returns:
        The settings for `benchmark.drive_split` on the recordings.

    Raises:
        InputError: If they are not the recordings that the split was made from.
    """
    from dataclasses import replace

    from benchmark.runs.encounters import find_windows, transfer_windows

    scenes = settings.chosen(data, split)
    windows = settings.windows or find_windows(data, scenes, unchanged, whole=settings.window != "encounter")
    own = transfer_windows(windows, data, unchanged, unchanged.scene_names(unchanged_split))
    return replace(
        settings, window=settings.window or "scene", windows=own, windows_of=split, scenes=tuple(own), limit=None
    )


def describe_target(target: str) -> dict[str, str]:
    """A target as a record has it: nothing where it is the adversary."""
    return {} if target == "adversary" else {"target": target}


def require_engine(engine: str, scenarios: str, target: str) -> None:
    """Raise `InputError` for scenarios that an engine of an extension has not, or a file that holds none."""
    from benchmark.closed_loop.engines import make_backend

    make_backend(engine, scenarios=scenarios, scenario_facts=describe_target(target))


def _given_tracks(directory: "Path", split: str) -> "tuple[AdversaryFactory, int]":
    """Adversaries on the tracks of a record of drives, and how many runs of each scene there are."""
    from benchmark.closed_loop.adversary import ScriptedTracks
    from benchmark.records.drives import load_drives
    from benchmark.runs.drive_rows import decode_adversary_track

    record = load_drives(directory)
    tracks = {(row.scene, row.run): decode_adversary_track(row) for row in record.rows}
    known = {at: track for at, track in tracks.items() if track is not None}
    if len(known) < len(tracks) or record.facts.split != split:
        raise InputError(
            f"{directory} does not hold an adversary's track for every drive of {split}; name the record of a "
            "planner that was driven with --agents adversary through the same split"
        )
    others = str(record.facts.measured.agents_facts.get("others", "replay"))
    facts = {"tracks_of": record.planner, "record": record.content_id, "others": others}
    return ScriptedTracks(known, others, facts), record.facts.runs


def require_sensor(sensor: str) -> None:
    """Raise `InputError` for a name of no sensor; no server is asked whether it answers."""
    from benchmark.closed_loop.observation_builder import NO_SENSOR
    from benchmark.machine.address import Address, is_address

    known = (NO_SENSOR, "schematic")
    if is_address(sensor):
        if Address.of(sensor, "--sensor").name in known:
            raise InputError(f"--sensor {sensor} has the name of a built-in sensor; rename it")
    elif sensor not in known:
        raise InputError(
            f"unknown sensor {sensor!r}; {did_you_mean(sensor, known)}choose from {' and '.join(known)}, and "
            "renderers at http://HOST:PORT"
        )


def _sensor(name: str, split: str, *, tensors: bool) -> "Sensor":
    from benchmark.closed_loop.observation_builder import NO_SENSOR, NoSensor
    from benchmark.machine.address import Address, is_address
    from benchmark.machine.extension import import_from_extension
    from benchmark.machine.workspace import is_generated
    from generation.render.sensor import SchematicSensor

    require_sensor(name)
    if is_address(name):
        served: Sensor = import_from_extension("sensor", "http")(Address.of(name, "--sensor"), tensors)
        return served
    # Generated splits are drawn in the second style, their recordings in the first.
    return NoSensor() if name == NO_SENSOR else SchematicSensor("second" if is_generated(split) else "first")
