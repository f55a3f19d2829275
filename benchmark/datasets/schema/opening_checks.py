"""Checks when a root is opened and when a scene of it is read: the first error is raised.

They cover the errors of `data check` in tables of scenes that are read; other files are checked when opened.
"""

from collections.abc import Collection, Mapping

from benchmark.datasets.schema import LINKS, FaultList
from benchmark.datasets.schema.links import check_chains, check_link, check_links, check_sample_chains
from benchmark.datasets.schema.provenance import check_adversaries
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.datasets.schema.values import check_images, check_rates, check_sensors, check_shared


def check_shared_and_samples(tables: CheckedTables, faults: FaultList, rates: FaultList) -> None:
    """Check what rows of the shared tables and of all samples say together; ``rates`` gets scenes at other rates."""
    check_links(tables, faults)
    check_sample_chains(tables, faults)
    check_shared(tables, faults)
    check_rates(tables, rates)


def check_scene(
    shared: CheckedTables,
    rows: Mapping[str, list[Row]],
    scene: Row,
    adversaries: Collection[str],
    faults: FaultList,
) -> None:
    """Check what the rows of one scene, and of the tables that do not grow with the scenes, say together."""
    scene_tables = CheckedTables.of_sound_rows({**rows, "scene": [scene]})
    tables = CheckedTables(
        {**shared.rows, **scene_tables.rows},
        {**shared.by_token, **scene_tables.by_token},
        scene_tables.unreadable,
        scene_tables.unsound,
    )
    for link in LINKS:
        if link.table in rows and link.target in rows:
            known = tables.by_token[link.target].keys()
            check_link(link, rows[link.table], known, faults, among=" among the rows of its scene")
    check_chains(tables, faults)
    check_images(tables, faults)
    check_sensors(tables, faults)
    check_adversaries(tables, scene, adversaries, faults)
