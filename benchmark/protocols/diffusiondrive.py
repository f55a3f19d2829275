"""The ``diffusiondrive`` protocol: the evaluation of DiffusionDrive's nuScenes branch.

Its evaluation code, data set and box functions are those of SparseDrive byte for byte, so every verdict and every rate
is the same (`benchmark.protocols.sparsedrive`). It has a name of its own because tables name protocols by the
repository whose numbers they are compared with.

Step k is the k-th following key frame, whenever that is: where key frames are not half a second apart, the horizons are
other times (scenes at another rate are not counted, `benchmark.datasets.steps`).
"""

from benchmark.protocols.sparsedrive import SparseDrive


class DiffusionDrive(SparseDrive):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__("diffusiondrive")
