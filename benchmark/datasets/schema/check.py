"""All checks of one data set, in the order in which a reader would trip over the faults."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.schema import Fault, FaultList
from benchmark.datasets.schema.files import check_files
from benchmark.datasets.schema.further_tables import check_further_tables
from benchmark.datasets.schema.links import check_chains, check_links, check_sample_chains
from benchmark.datasets.schema.maps import check_maps
from benchmark.datasets.schema.motion import EgoAtSamples, check_motion
from benchmark.datasets.schema.provenance import check_provenance, check_splits
from benchmark.datasets.schema.rates import check_gaps, check_rates
from benchmark.datasets.schema.table_checks import read_checked
from benchmark.datasets.schema.truth import check_truth
from benchmark.datasets.schema.values import check_copied_intrinsics, check_images, check_sensors, check_shared
from benchmark.datasets.tables import variant_folders, version_folders
from benchmark.errors import InputError


def check_tables(root: Path, *, version: str | None = None, categories: Mapping[str, str] | None = None) -> list[Fault]:
    """Everything that is wrong with a nuScenes-format data set.

    Linear in the number of rows. Of each kind of fault in each table the first few are told and the rest counted.

    Args:
        root: Root of the data set; a folder that directly holds tables, or one root a variant (``v0``, ``v1``, ...:
            the tables of the faults then begin with the variant's name), will do too.
        version: Version folder, or ``None`` to take the only one.
        categories: What other names of categories mean (`benchmark.datasets.categories.read_categories`).

    Returns:
        The faults, errors first; empty if there are none.

    Raises:
        InputError: If there is no such folder, no tables in it, or several versions to choose from.
    """
    if not root.is_dir():
        raise InputError(f"there is no folder {root}; give the root of a nuScenes-format data set")
    variants = variant_folders(root)
    if variants and not version_folders(root):
        faults = [
            replace(fault, table=f"{variant}/{fault.table}")
            for variant in variants
            for fault in check_tables(root / variant, version=version, categories=categories)
        ]
        return sorted(faults, key=lambda fault: fault.severity)
    folder, data_root = _table_folder(root, version)
    return _check(folder, data_root, categories or {})


def _check(folder: Path, data_root: Path, categories: Mapping[str, str]) -> list[Fault]:
    faults = FaultList()
    tables = read_checked(folder, faults)
    check_links(tables, faults)
    check_sample_chains(tables, faults)
    check_rates(tables, faults)
    check_gaps(tables, faults)
    check_chains(tables, faults)
    check_shared(tables, faults)
    check_images(tables, faults)
    check_copied_intrinsics(tables, faults)
    check_sensors(tables, faults)
    check_files(data_root, tables, faults)
    ego = EgoAtSamples.of(tables)
    check_maps(data_root, tables, ego, faults)
    check_motion(tables, ego, faults)
    check_truth(tables, categories, faults)
    check_splits(folder, data_root, tables, faults)
    check_provenance(folder, tables, faults)
    check_further_tables(folder, data_root, tables, faults)
    return faults.told()


def _table_folder(root: Path, version: str | None) -> tuple[Path, Path]:
    """Folder of the tables, and folder that file names are relative to."""
    if version is not None:
        if Path(version).name != version or not (root / version).is_dir():
            known = ", ".join(version_folders(root)) or "none"
            raise InputError(f"{root} has no version folder {version!r}; versions there: {known}")
        return root / version, root
    if any((root / f"{table}.json").is_file() for table in NUSCENES_TABLES):
        return root, root.parent
    found = version_folders(root)
    if not found:
        raise InputError(f"{root} holds no nuScenes tables (scene.json and 12 more); give the root of a data set")
    if len(found) > 1:
        raise InputError(f"{root} has several versions ({', '.join(found)}); name one with --tables")
    return root / found[0], root
