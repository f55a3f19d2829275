"""What makes a kept plan stale: the hash of the code that a planner's plans depend on, and of nothing else.

From the planner's class the names that its code uses are followed to where they are defined, import after import, also
of those inside functions, within the class's own top-level package and within this project; libraries count by the
versions that a run record names. What is found counts as syntax trees without docstrings, comments and import lines,
each keyed by its name without its module. So a definition may move, and a line may be commented, and plans stay.

Two measures, because a package of strangers may do anything when it is imported (fill a registry, patch a class):

* of packages of strangers all of each imported module counts, with the packages that it lies in;
* of this project, whose modules do nothing when they are imported, only the definitions that are reached count.

What a name stands for counts, not how it is imported: a name from the public face of a package leads to the module that
defines it, also where a module-level ``__getattr__`` looks it up. Text that names a module (``"package.module"``,
``"package.module:name"``) is followed like an import; ``"package."``, of which a name is made, leads to all modules of
the package. A class that is found through nothing of this is given by hand: the function that made the planner
(``made_by``), the classes of its parts.

`outside_identity` marks, where a thing is defined, what is not followed.
"""

import importlib
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, TypeVar

from benchmark.machine.storage import content_key
from benchmark.planning import Planner, PrivilegedPlanner
from benchmark.runs.module_files import OURS, ModuleFiles, is_local, source_of, top_package
from benchmark.runs.source_files import ON_IMPORT, Import, SourceFile, absolute_name

_REFERENCE: Final = re.compile(r"\.*[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(:[A-Za-z_][\w.]*)?")
_PREFIX: Final = re.compile(r"([A-Za-z_]\w*(\.[A-Za-z_]\w*)*)\.")
_LISTS_MODULES: Final = frozenset({"iter_modules", "walk_packages"})
Anything = TypeVar("Anything")


def outside_identity(definition: Anything) -> Anything:
    """Mark what plans use but do not depend on, because what comes of it is part of a run's identity anyway.

    For example what finds or converts a file of weights: the hash of the file is kept with every plan.

    Args:
        definition: A function or class, as a decorator; or the value of a constant.

    Returns:
        The same.
    """
    return definition


@dataclass(frozen=True, slots=True, order=True)
class Dependency:
    """A top-level name of a module that plans depend on.

    Attributes:
        module: The module.
        name: The name; empty for what the module does when it is imported.
    """

    module: str
    name: str


def code_sha256(planner_class: type, *, made_by: str | None = None, parts: frozenset[type] = frozenset()) -> str | None:
    """Hash of the code that a planner's plans depend on, so that changed code is never taken for done work.

    Args:
        planner_class: Its class.
        made_by: The function or class that made it, as ``package.module:name``.
        parts: Classes of what it was given, such as its network.

    Returns:
        The hash; ``None`` if the class has no source file.
    """
    return _identity(planner_class, made_by, parts)[0]


def dependencies_of(
    planner_class: type, *, made_by: str | None = None, parts: frozenset[type] = frozenset()
) -> tuple[Dependency, ...]:
    """What `code_sha256` is the hash of.

    Args:
        planner_class: A planner's class.
        made_by: The function or class that made it, as ``package.module:name``.
        parts: Classes of what it was given, such as its network.

    Returns:
        All definitions, by module and name.
    """
    return _identity(planner_class, made_by, parts)[1]


def parts_of(planner: Any) -> frozenset[type]:
    """Classes of what a planner was given or made, the modules of networks included.

    Args:
        planner: The planner.

    Returns:
        Those of its attributes' values.
    """
    values = list(getattr(planner, "__dict__", {}).values())
    torch = sys.modules.get("torch")
    networks = [value for value in values if torch is not None and isinstance(value, torch.nn.Module)]
    return frozenset(map(type, values)) | {type(each) for network in networks for each in network.modules()}


@cache
def _identity(
    planner_class: type, made_by: str | None, parts: frozenset[type]
) -> tuple[str | None, tuple[Dependency, ...]]:
    file = source_of(planner_class)
    if file is None:
        return None, ()
    files = ModuleFiles(planner_class.__module__, file)
    given = [each for each in (*planner_class.__mro__[1:], *parts) if files.follows(each.__module__) or is_local(each)]
    files.followed |= {top_package(each.__module__) for each in given}
    reach = _Reach(files)
    contract = PrivilegedPlanner if hasattr(planner_class, "reveal") else Planner
    for each in (planner_class, contract, *given):
        reach.start(each.__module__, each.__qualname__)
    name_of_class = planner_class.__qualname__
    module, _, maker = (made_by or f":{name_of_class}").partition(":")
    if made_by is not None:
        files.followed.add(top_package(module))
        reach.start(module, maker)
    return content_key(name_of_class, maker, reach.entries()), tuple(sorted(reach.found))


class _Reach:
    """All definitions that can be reached from a few.

    Args:
        files: Of the modules.
    """

    def __init__(self, files: ModuleFiles) -> None:
        self.found: set[Dependency] = set()
        self._files = files
        self._waiting: list[Dependency] = []

    def start(self, module: str, qualname: str) -> None:
        """Reach a definition; all of its module if it is not at the top level there."""
        for each in self._defined(module, (qualname.partition(".")[0],)):
            if isinstance(each, Dependency):
                self._reach(each)
        while self._waiting:
            self._expand(self._waiting.pop())

    def entries(self) -> list[list[Any]]:
        """What was found, without modules: name, what it says, and what the names in it stand for."""
        return sorted(self._entry(each) for each in self.found if self._text(each))

    def _entry(self, found: Dependency) -> list[Any]:
        source = self._source(found.module)
        stand_for = set()
        for used in source.read(found.name).uses:
            for each in self._meant(source, found, used):
                said = each if isinstance(each, str) else f"{each.name} {self._text(each)}"
                stand_for.add((used[0], said))
        return [found.name, self._text(found), sorted(map(list, stand_for))]

    def _text(self, found: Dependency) -> str:
        source = self._source(found.module)
        if found.name in source.outside:
            return ""
        reading = source.read(found.name)
        return reading.sha256 if reading.text else ""

    def _source(self, module: str) -> SourceFile:
        source = self._files.source(module)
        if source is None:
            raise LookupError(module)
        return source

    def _reach(self, found: Dependency) -> None:
        if found not in self.found and found.name not in self._source(found.module).outside:
            self.found.add(found)
            self._waiting.append(found)

    def _reach_module(self, module: str) -> None:
        """What importing a module of strangers brings: all of it, and of the packages that it lies in."""
        parts = module.split(".")
        for end in range(1, len(parts) + 1):
            for each in self._whole(".".join(parts[:end])):
                self._reach(each)

    def _whole(self, module: str) -> list[Dependency]:
        source = self._files.source(module)
        return [] if source is None else [Dependency(module, name) for name in list(source.definitions)]

    def _expand(self, found: Dependency) -> None:
        source = self._source(found.module)
        reading = source.read(found.name)
        if top_package(found.module) not in OURS:
            self._reach_module(found.module)
        else:
            self._reach(Dependency(found.module, ON_IMPORT))
        for module in reading.modules:
            if top_package(module) not in OURS and self._files.follows(module):
                self._reach_module(module)
        meant = [each for used in reading.uses for each in self._meant(source, found, used)]
        meant += [each for text in reading.strings for each in self._named(text, source.package)]
        if any(_LISTS_MODULES & set(used) for used in reading.uses):
            meant += [each for module in self._files.within(source.package) for each in self._whole(module)]
        for each in meant:
            if isinstance(each, Dependency):
                self._reach(each)

    def _meant(self, source: SourceFile, found: Dependency, used: tuple[str, ...]) -> Iterator[Dependency | str]:
        """What a name with its attributes stands for in a definition: ours or a stranger's, or text for a library's."""
        name, rest = used[0], used[1:]
        if name in source.definitions and name != ON_IMPORT:
            yield Dependency(found.module, name)
        own = source.read(found.name).imports.get(name, set())
        for each in own | source.imports.get(name, set()):
            yield from self._imported(each, rest)

    def _imported(
        self, made: Import, rest: tuple[str, ...], seen: frozenset[tuple[str, str]] = frozenset()
    ) -> Iterator[Dependency | str]:
        if not self._files.follows(made.module):
            yield ".".join([made.module, *([made.name] if made.name else []), *rest])
        else:
            yield from self._defined(made.module, (made.name, *rest) if made.name else rest, seen)

    def _defined(
        self, module: str, path: tuple[str, ...], seen: frozenset[tuple[str, str]] = frozenset()
    ) -> Iterator[Dependency | str]:
        """Where a name of a module is defined, by the steps that Python takes; all of the module if that is unclear."""
        source = self._files.source(module)
        if not path or (source is not None and (module, path[0]) in seen):
            yield from self._whole(module)
            return
        name, rest = path[0], path[1:]
        if source is not None and name in source.definitions:
            yield Dependency(module, name)
        elif source is not None and name in source.imports:
            for each in source.imports[name]:
                yield from self._imported(each, rest, seen | {(module, name)})
        elif self._files.exists(f"{module}.{name}"):
            yield from self._defined(f"{module}.{name}", rest, seen)
        elif source is not None and "__getattr__" in source.definitions and (owner := self._owner(module, name)):
            yield from self._defined(owner, path, seen | {(module, name)})
        else:
            yield from self._whole(module)

    def _named(self, text: str, package: str) -> Iterator[Dependency | str]:
        """Modules that a text names."""
        if prefix := _PREFIX.fullmatch(text):
            for module in self._files.within(prefix[1]):
                yield from self._whole(module)
        elif _REFERENCE.fullmatch(text) and ("." in text or ":" in text):
            name, _, attribute = text.partition(":")
            parts = absolute_name(name, package).split(".")
            known = [end for end in range(len(parts), 0, -1) if self._files.source(".".join(parts[:end])) is not None]
            if known and (len(parts) > 1 or attribute):
                path = [*parts[known[0] :], *filter(None, attribute.split("."))]
                yield from self._defined(".".join(parts[: known[0]]), tuple(path))

    def _owner(self, module: str, name: str) -> str | None:
        """The module that defines what a module-level ``__getattr__`` hands on; a constant does not say so itself."""
        try:
            value = getattr(importlib.import_module(module), name)
        except Exception:
            return None
        owner = getattr(value, "__module__", None)
        if not isinstance(owner, str):
            loaded = sorted(
                each for each, found in sys.modules.items() if getattr(found, "__dict__", {}).get(name) is value
            )
            sources = ((each, self._files.source(each)) for each in loaded)
            owner = next((each for each, source in sources if source is not None and name in source.definitions), None)
        return owner if owner != module else None
