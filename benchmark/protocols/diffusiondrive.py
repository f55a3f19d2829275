"""The ``diffusiondrive`` protocol: the evaluation of DiffusionDrive's nuScenes branch.

Its evaluation code, data set and box functions are those of SparseDrive byte for byte, so every verdict and every rate
is the same (`benchmark.protocols.sparsedrive`). It has a name of its own because tables name protocols by the
repository whose numbers they are compared with.
"""

from benchmark.protocols.sparsedrive import SparseDrive


class DiffusionDrive(SparseDrive):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__("diffusiondrive")
