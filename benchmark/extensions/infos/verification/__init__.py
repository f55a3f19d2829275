"""`challenger-bench verify infos`: info files, as the converters would write them, against those that they wrote."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmark.extensions.infos.exporting import InfoSettings, build_info_files
from benchmark.extensions.infos.repositories import REPOSITORIES
from benchmark.extensions.infos.verification.comparison import MANIFEST, GoldenInfos, InfoComparison
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet


def _compare_infos(comparison: Comparison, golden: GoldenFolder) -> None:
    """Compare exported infos key by key, to the tolerances of the set's manifest."""
    stored = GoldenInfos.read(golden)
    info_comparison = InfoComparison(comparison, stored.tolerances)
    with TemporaryDirectory() as folder:
        for name, golden_root in stored.roots.items():
            root = stored.unpack(name, Path(folder))
            info_comparison.tables(name, golden_root.changed_tables(root))
            for golden_file in golden_root.files:
                settings = InfoSettings(golden_file.repository, version=golden_root.version, as_converted=True)
                reader = REPOSITORIES[golden_file.repository]
                info_comparison.files(name, golden_file, build_info_files(root, reader, settings))


GOLDEN: Final = GoldenSet(
    name="infos",
    usual="info_files",
    files=(MANIFEST,),
    compare=(_compare_infos,),
    holds="what official converters wrote",
)
