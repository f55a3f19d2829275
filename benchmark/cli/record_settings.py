"""Settings that records hold, for ``--config``: what a record says of how it was made, as options of its command.

What is not stored has its default and may be given beside: the root of a data set whose name alone is stored, weights,
plan and result files, devices, addresses of servers, a file of categories.
"""

from collections.abc import Mapping
from typing import Any

from benchmark.records.fault import FAULT, NUPLAN_FAULT

_GIB = float(1 << 30)


def read_eval_options(members: Mapping[str, Any]) -> dict[str, Any] | None:
    """Options of ``eval`` from a run record (``run.json``); ``None`` for anything else."""
    if "protocols" not in members or "planner" not in members:
        return None
    from benchmark.protocols import STANDARD

    planner, config = members["planner"], members.get("config", {})
    judges = [name for name in config.get("protocols", ()) if name not in (*STANDARD, planner.get("native_protocol"))]
    supervision = config.get("supervision", {})
    published = _as_published(planner.get("settings", {}))
    return {
        **_read_common_options(members),
        "split": [members["split"]],
        "protocol": judges or None,
        "sample_limit": supervision.get("sample_limit_s"),
        "as_published": published or None,
    }


def read_drive_options(members: Mapping[str, Any]) -> dict[str, Any] | None:
    """Options of ``drive`` from a record of drives (``drive.json``); ``None`` for anything else."""
    if "measured" not in members or "planner" not in members:
        return None
    measured, config = members["measured"], members.get("config", {})
    facts, scenario_facts = measured.get("agents_facts", {}), measured.get("scenario_facts", {})
    sensor, windows_of = measured["sensor"], measured.get("windows_of")
    adversary = {"knows": "knows", "every": "every_s", "others": "others", "rounds": "rounds"}
    adversary["candidates"] = "candidates"
    searched = measured["agents"] == "adversary" and "every_s" in facts
    return {
        **_read_common_options(members),
        "split": [*([windows_of["split"]] if windows_of else []), members["split"]],
        "baselines": False,
        "engine": measured["engine"],
        "agents": facts.get("address", measured["agents"]) if "traffic" in facts else measured["agents"],
        "window": measured.get("window", "scene"),
        "plan_hz": str(measured.get("plan_hz", 2)),
        "sensor": sensor if sensor in ("none", "schematic") else None,
        "latency": measured.get("latency_ms"),
        "scenarios": scenario_facts.get("file", measured.get("scenarios")),
        "target": scenario_facts.get("target"),
        # Older records call nuPlan's rule "fault".
        "until": {"fault": NUPLAN_FAULT, FAULT: "fault"}.get(measured.get("until"), measured.get("until")),
        "runs": members.get("runs"),
        "timeout": config.get("timeout_s"),
        **({f"adversary_{name}": facts.get(fact_name) for name, fact_name in adversary.items()} if searched else {}),
    }


def read_generate_options(members: Mapping[str, Any]) -> dict[str, Any] | None:
    """Options of ``generate`` from the search of a built split (``search.json``); ``None`` for anything else."""
    if "hyper" not in members or "hyper_fingerprint" not in members:
        return None
    hyper, sampler = members["hyper"], members.get("sampler") or {}
    return {
        "seed": members["seed"],
        # Every hyper-parameter is named; the preset says which trajectory model draws candidates.
        "preset": "effect" if "further" in members else "default" if sampler.get("conditioned", True) else "paper",
        "set": hyper,
        "manoeuvre": members.get("asked"),
        "samples": sampler.get("samples"),
        "calls": sampler.get("mutation_steps"),
        "dropout": sampler.get("dropout"),
    }


def _read_common_options(members: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that records of runs and of drives hold alike."""
    from adapters.models import MODELS

    planner, config = members["planner"], members.get("config", {})
    scenes, memory = members["scenes"], config.get("supervision", {}).get("memory_limit_bytes")
    return {
        # For a planner of another package the name is stored, not the location of its class.
        "model": [planner["name"]] if planner["name"] in MODELS else None,
        "data": members["data"]["name"],
        "scenes": None if len(scenes) == members["scenes_in_split"] else scenes,
        "seed": members["seed"],
        "driving_side": config.get("driving_side"),
        "memory_limit": None if memory is None else memory / _GIB,
    }


def _as_published(settings: Mapping[str, Any]) -> list[str]:
    from benchmark.records.run_schema import AS_PUBLISHED

    quirks = settings.get(AS_PUBLISHED)
    return quirks.split("+") if isinstance(quirks, str) else []
