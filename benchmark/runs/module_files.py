"""Where the modules lie whose code may count for a planner: in its own package, in this project, beside a script."""

import inspect
import pkgutil
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from benchmark.runs.source_files import SourceFile, source_file

OURS: Final = frozenset({"benchmark", "adapters"})
"""Packages of this project that plans may depend on."""
_LIBRARIES: Final = frozenset({"torch"})
"""Never followed, even where it is not installed but imported from its sources."""
_INSTALLED: Final = frozenset({"site-packages", "dist-packages"})


def top_package(module: str) -> str:
    """The first part of a module's name."""
    return module.partition(".")[0]


def source_of(made: type) -> Path | None:
    """The file that a class is written in; ``None`` if there is none, as in a notebook."""
    try:
        source = inspect.getsourcefile(made)
    except (TypeError, OSError):
        return None
    return Path(source) if source is not None and Path(source).is_file() else None


def is_local(made: type) -> bool:
    """Whether a class is this project's or a stranger's: neither Python's nor an installed library's."""
    top = top_package(made.__module__)
    if top in OURS:
        return True
    if top in sys.stdlib_module_names or top in _LIBRARIES:
        return False
    file = source_of(made)
    return file is not None and not _INSTALLED & set(file.parts)


class ModuleFiles:
    """Files of the modules that are followed.

    Args:
        module: Of the planner's class.
        file: Of that module.

    Attributes:
        followed: Top-level packages.
    """

    def __init__(self, module: str, file: Path) -> None:
        self.followed = {top_package(module), *OURS}
        alone = "." not in module and file.name != "__init__.py" and not _INSTALLED & set(file.parts)
        # A module that is in no package belongs with those that lie beside it.
        self._beside = file.parent if alone else None
        self._known: dict[str, tuple[Path | None, tuple[Path, ...]]] = {module: (file, _folders(file))}
        self._sources: dict[str, SourceFile | None] = {}

    def source(self, module: str) -> SourceFile | None:
        """The module, if it is followed and has a file that can be read."""
        if module not in self._sources:
            file = self._located(module)[0] if self.follows(module) else None
            self._sources[module] = None if file is None else source_file(file, module)
        return self._sources[module]

    def exists(self, module: str) -> bool:
        """Whether there is such a module or folder of modules."""
        return self.follows(module) and self._located(module) != (None, ())

    def follows(self, module: str) -> bool:
        """Whether a module is in one of the packages that count."""
        top = top_package(module)
        return top in self.followed or (self._beside is not None and self._lies_beside(top))

    def _lies_beside(self, top: str) -> bool:
        file, folders = self._located(top)
        places = [file.parent if file.name != "__init__.py" else file.parent.parent] if file else []
        return self._beside in (places or [folder.parent for folder in folders])

    def within(self, package: str) -> list[str]:
        """Names of all modules in a package, those of its packages included."""
        folders = [str(folder) for folder in self._located(package)[1]] if self.follows(package) else []
        names = [f"{package}.{found.name}" for found in pkgutil.iter_modules(folders)]
        return [each for name in names for each in (name, *self.within(name))]

    def _located(self, module: str) -> tuple[Path | None, tuple[Path, ...]]:
        """The file of a module, and the folders in which its own modules lie."""
        if module not in self._known:
            parent, _, last = module.rpartition(".")
            if parent:
                places = [_in_folder(folder, last) for folder in self._located(parent)[1]]
                files = [place for place in places if place[0] is not None]
                spread = tuple(folder for _, folders in places for folder in folders)
                self._known[module] = files[0] if files else (None, spread)
            else:
                self._known[module] = self._top(module)
        return self._known[module]

    def _top(self, module: str) -> tuple[Path | None, tuple[Path, ...]]:
        loaded: Any = sys.modules.get(module)
        if loaded is None:
            try:
                spec = find_spec(module)
            except (ImportError, ValueError):
                return None, ()
            file, folders = (None, None) if spec is None else (spec.origin, spec.submodule_search_locations)
        else:
            file, folders = getattr(loaded, "__file__", None), getattr(loaded, "__path__", None)
        path = Path(file) if file is not None and file.endswith(".py") else None
        return path, tuple(Path(folder) for folder in folders or ())


def _in_folder(folder: Path, name: str) -> tuple[Path | None, tuple[Path, ...]]:
    for file in (folder / name / "__init__.py", folder / f"{name}.py"):
        if file.is_file():
            return file, _folders(file)
    return None, (folder / name,) if (folder / name).is_dir() else ()


def _folders(file: Path) -> tuple[Path, ...]:
    return (file.parent,) if file.name == "__init__.py" else ()
