"""Importing nuscenes-devkit without what only its drawing and lidar statistics need; its object over rows read here.

The devkit imports scikit-learn (and so scipy.stats and pandas) and pyplot, seconds of processor time in each process
for nothing that is used here. Its modules get stand-ins that import the real module on first use; ``sys.modules`` holds
none, so no other code meets one.
"""

import builtins
import importlib
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Any, Final

from benchmark.datasets.tables import Row, Tables
from benchmark.errors import InputError

_PUT_OFF: Final = (
    "sklearn.metrics",
    "matplotlib.pyplot",
    "matplotlib.axes",
    "matplotlib.patches",
    "matplotlib.backends.backend_agg",
    "matplotlib.rcParams",
)
"""Names that the devkit needs at import and uses only in functions that are never called here."""

_lock = threading.RLock()


class _LazyObject:
    """Stands in for a module, or for something in it, until anything is asked of it."""

    def __init__(self, path: str) -> None:
        self._path = path

    def __getattr__(self, name: str) -> Any:
        # Classes are named in annotations, which are evaluated when the devkit is imported.
        return _LazyObject(f"{self._path}.{name}") if name[:1].isupper() else getattr(resolve_name(self._path), name)

    def __setitem__(self, key: Any, value: Any) -> None:
        resolve_name(self._path)[key] = value

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return resolve_name(self._path)(*arguments, **named)


class _LazyPackage:
    """Stand-in that ``import sklearn.metrics`` binds, with nothing imported yet."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        path = f"{self._name}.{name}"
        if path in _PUT_OFF:
            return _LazyObject(path)
        if any(module.startswith(f"{path}.") for module in _PUT_OFF):
            return _LazyPackage(path)
        return getattr(importlib.import_module(self._name), name)


class _LazyNames:
    """Stand-in that ``from matplotlib.axes import Axes`` takes its names from."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return _LazyObject(f"{self._module}.{name}")


def _import(name: str, scope: Any = None, local: Any = None, wanted: Sequence[str] = (), level: int = 0) -> Any:
    """``__import__`` as modules of the devkit see it."""
    if level == 0 and name in _PUT_OFF:
        return _LazyNames(name) if wanted else _LazyPackage(name.partition(".")[0])
    if level == 0 and any(f"{name}.{attribute}" in _PUT_OFF for attribute in wanted or ()):
        return _LazyPackage(name)
    return builtins.__import__(name, scope, local, wanted, level)


class _DevkitLoader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": _import}
        super().exec_module(module)


class _DevkitFinder(MetaPathFinder):
    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The usual specification, with a loader that puts imports off."""
        if name.partition(".")[0] != "nuscenes":
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and type(spec.loader) is SourceFileLoader:
            spec.loader = _DevkitLoader(spec.loader.name, spec.loader.path)
        return spec


def import_devkit_module(name: str) -> Any:
    """Module of nuscenes-devkit, as its authors meant it where it was imported before."""
    with _lock, _devkit_finder_installed():
        return importlib.import_module(name)


@contextmanager
def _devkit_finder_installed() -> Iterator[None]:
    finder = _DevkitFinder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


FURTHER_TABLES: Final = ("lidarseg", "panoptic", "image_annotations")
"""Optional tables that the devkit reads and this package does not."""


def build_devkit(root: Path, version: str, tables: Tables) -> Any:
    """``NuScenes`` of the devkit with rows that are at hand."""
    as_published: Any = import_devkit_module("nuscenes.nuscenes").NuScenes

    class NuScenesWithRows(as_published):  # type: ignore[misc]
        """``NuScenes`` that is given its rows and reads no files; it reads tables that this product never uses."""

        def __load_table__(self, table: str) -> list[Row]:
            rows: list[Row] = tables[table] if table in tables else super().__load_table__(table)
            return rows

    try:
        return NuScenesWithRows(version=version, dataroot=str(root), verbose=False)
    except Exception as error:
        raise InputError(
            f"nuscenes-devkit cannot open {root / version} ({type(error).__name__}: {error}); correct the tables"
        ) from error
