"""Options of ``serve --protocol neuroncap``."""

from dataclasses import dataclass
from typing import Annotated

from benchmark.cli.settings import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class NeuroncapServeOptions:
    """Options of ``serve`` for NeuroNCAP's protocol."""

    accept_torch_tensors: Annotated[
        bool, Option("Pictures may be saved tensors, as NeuroNCAP's (pickles).", "Planner")
    ] = False
