"""`challenger-bench verify infos`: info files, as the converters would write them, against those that they wrote."""

from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark.errors import InputError
from benchmark.extensions.infos.exporting import InfoSettings, info_files
from benchmark.extensions.infos.repositories import REPOSITORIES
from benchmark.extensions.infos.verification.comparison import InfoComparison
from benchmark.extensions.infos.verification.golden_set import GoldenInfos
from benchmark.verification.checks import Check

__all__ = ["verify_infos"]


def verify_infos(golden: Path | None = None) -> list[Check]:
    """Compare exported infos with a golden set, key by key, to the tolerances of its manifest.

    Args:
        golden: Directory of the set: ``manifest.json``, the tables of roots and the files of the converters.

    Returns:
        One check for each key of each repository, over all roots, and one for the tables that roots are made of.

    Raises:
        InputError: If there is no set, or it cannot be used.
    """
    if golden is None:
        raise InputError("verify infos needs --golden, a directory of what official converters wrote; none is built in")
    found = GoldenInfos.read(golden)
    comparison = InfoComparison(found.tolerances)
    with TemporaryDirectory() as folder:
        for name, golden_root in found.roots.items():
            root = found.unpack(name, Path(folder))
            comparison.tables(name, golden_root.changed_tables(root))
            for golden_file in golden_root.files:
                settings = InfoSettings(golden_file.repository, version=golden_root.version, as_converted=True)
                reader = REPOSITORIES[golden_file.repository]
                comparison.files(name, golden_file, info_files(root, reader, settings))
    return comparison.checks()
