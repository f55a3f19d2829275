"""Protocols by name: every definition of collision and L2 that a run is judged by."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Final

from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import call_extension, list_offers
from benchmark.protocols.agent_driver import AgentDriverProtocol, AgentDriverSTP3Protocol
from benchmark.protocols.bev_planner import BEVPlannerProtocol
from benchmark.protocols.contract import (
    CollisionProtocol,
    GroundTruthMask,
    ProtocolOutcomes,
    compute_published_values,
    counts_at_all_horizons,
)
from benchmark.protocols.exact import ExactProtocol
from benchmark.protocols.omnidrive import OmniDriveProtocol
from benchmark.protocols.opendrivevla import OpenDriveVLAProtocol, OpenDriveVLASTP3Protocol
from benchmark.protocols.safemvdrive import SafeMVDriveBoxProtocol, SafeMVDriveProtocol
from benchmark.protocols.sparsedrive import DiffusionDriveProtocol, SparseDriveProtocol
from benchmark.protocols.stp3 import STP3Protocol
from benchmark.protocols.uniad import UniADProtocol
from benchmark.protocols.vad import COUNTED_23, COUNTED_32, VADProtocol

__all__ = [
    "LEAVING_OUT",
    "MAXIMA",
    "NATIVE_PROTOCOLS",
    "PROTOCOLS",
    "STANDARD",
    "CollisionProtocol",
    "GroundTruthMask",
    "ProtocolOutcomes",
    "compute_published_values",
    "counts_at_all_horizons",
    "find_category_protocols",
    "find_masking_protocols",
    "find_protocol",
    "register",
]


class ProtocolTable(dict[str, CollisionProtocol]):
    """Protocols by name: ours, then judges of other packages, each imported when it is looked up."""

    def __missing__(self, name: str) -> CollisionProtocol:
        if name not in self._list_judges():
            raise KeyError(name)
        return _make_judge(name)

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self._list_judges()

    def __iter__(self) -> Iterator[str]:
        return iter((*super().__iter__(), *self._list_judges()))

    def _list_judges(self) -> Mapping[str, str]:
        return list_offers("judge", (*super().__iter__(), "native", "pdm", "all"))


@cache
def _make_judge(name: str) -> CollisionProtocol:
    judge: CollisionProtocol = call_extension("judge", name)
    if judge.name != name:
        raise InputError(f"the judge {name} calls itself {judge.name!r}; give it the name that it is offered under")
    return judge


PROTOCOLS: Final = ProtocolTable()
"""Every known protocol, in the order of their columns."""
NATIVE_PROTOCOLS: Final = ("uniad", "vad", "sparsedrive", "diffusiondrive")
"""Those of the repositories of the four planners that the paper tests."""

STANDARD: Final = ("exact", "uniad", "vad", "vad-23", "sparsedrive", "diffusiondrive")
"""Those that every run is judged by; the others judge on request, and stored plans whenever they are judged anew."""

MAXIMA: Final = frozenset({"bev-planner", "omnidrive", "safemvdrive", "safemvdrive-box", "safemvdrive-box-all"})
"""Official protocols whose collision rate is a maximum over the steps, or latched: no column of means may hold them."""

LEAVING_OUT: Final = frozenset({"safemvdrive", "safemvdrive-box", "safemvdrive-box-all"})
"""Official protocols that leave out whole samples because of the recorded ego, where others mask steps."""


def register(definition: CollisionProtocol) -> None:
    """Make a protocol known.

    Args:
        definition: The protocol.

    Raises:
        ValueError: If the name is taken: two protocols never share a column.
    """
    if dict.__contains__(PROTOCOLS, definition.name):
        raise ValueError(f"a protocol named {definition.name!r} is already registered; choose another name")
    PROTOCOLS[definition.name] = definition


def find_protocol(name: str) -> CollisionProtocol:
    """Look a protocol up.

    Args:
        name: Its name.

    Returns:
        The protocol.

    Raises:
        InputError: If there is none of this name.
    """
    if name not in PROTOCOLS:
        raise InputError(f"unknown protocol {name!r}; {did_you_mean(name, PROTOCOLS)}known are {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def find_category_protocols(names: Iterable[str]) -> tuple[str, ...]:
    """Those of some known protocols for which it depends on an object's category whether it can be hit."""
    # Protocols of other packages may predate this attribute.
    return tuple(name for name in names if getattr(PROTOCOLS[name], "uses_categories", True))


def find_masking_protocols() -> dict[str, GroundTruthMask]:
    """Protocols that take back collisions at steps at which the recorded ego collides, in the order of `PROTOCOLS`."""
    return {name: definition for name, definition in PROTOCOLS.items() if isinstance(definition, GroundTruthMask)}


for definition in (
    ExactProtocol(),
    UniADProtocol(),
    VADProtocol("vad", COUNTED_32),
    VADProtocol("vad-23", COUNTED_23),
    SparseDriveProtocol(),
    DiffusionDriveProtocol(),
    STP3Protocol(),
    BEVPlannerProtocol(),
    OmniDriveProtocol(),
    SafeMVDriveProtocol(),
    SafeMVDriveBoxProtocol("safemvdrive-box", needs_points=True),
    SafeMVDriveBoxProtocol("safemvdrive-box-all", needs_points=False),
    OpenDriveVLAProtocol(),
    OpenDriveVLASTP3Protocol(),
    AgentDriverProtocol(),
    AgentDriverSTP3Protocol(),
):
    register(definition)
