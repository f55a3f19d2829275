"""Identity of planner code: a hash by which a cached plan is recognised as stale.

All of `benchmark` and `adapters` counts, but for what no plan depends on (`APART`) and for extensions that the planner
does not use; of other code the planner's own package, and modules that its module imports, directly, through others or
inside functions, unless they are Python's or an installed library's. A module counts as its syntax tree without
docstrings, comments and the form of its lines. What a planner loads under names that it makes up while it plans is
known afterwards alone (`hash_loaded_code`); it is kept with the plans, which are stale when any of it changed
(`is_current`).
"""

import ast
import contextlib
import hashlib
import inspect
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, lru_cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.machine.user_cache import cache_root
from benchmark.runs.units import ResultStore

OURS: Final = ("benchmark", "adapters")
APART: Final = (
    "benchmark/api",
    "benchmark/cli",
    "benchmark/report",
    "benchmark/scene_pages",
    "benchmark/extensions",
    "adapters/extensions",
)
"""Code that the hash of this project excludes; extensions count where a planner imports them."""
_NO_STRANGERS: Final = (*OURS, "generation", "leaderboard", "__main__", "__mp_main__")
_INSTALLED: Final = frozenset({"site-packages", "dist-packages"})
_LIBRARIES: Final = frozenset({"torch"})
"""Never followed, even where it is not installed but imported from its sources."""
_SAYS_NOTHING: Final = frozenset({"ctx", "kind", "type_comment", "type_ignores"})


def code_sha256(made: type, *, made_by: str | None = None, parts: frozenset[type] = frozenset()) -> str | None:
    """Hash of the code that the actions of a planner (or an engine) depend on, 64 hexadecimal digits.

    ``None`` if the class has no source file, as in a notebook. ``made_by`` is ``package.module:name``; ``parts`` are
    classes of what it was given, such as its network.
    """
    return _identity(made, made_by, parts)


@cache
def _identity(made: type, made_by: str | None, parts: frozenset[type]) -> str | None:
    """`code_sha256`, once a process: every unit of work asks for it."""
    if _source_of(made) is None:
        return None
    module, _, maker = (made_by or f"{made.__module__}:{made.__qualname__}").partition(":")
    start = {part.__module__ for part in (*made.__mro__, *parts)} | {module}
    return content_key(project_sha256(), made.__qualname__, maker, sorted(hash_modules(start, made).items()))


def list_part_classes(planner: Any) -> frozenset[type]:
    """Classes of the values of a planner's attributes, the modules of networks included."""
    values = list(getattr(planner, "__dict__", {}).values())
    torch = sys.modules.get("torch")
    networks = [value for value in values if torch is not None and isinstance(value, torch.nn.Module)]
    return frozenset(map(type, values)) | {type(module) for network in networks for module in network.modules()}


@cache
def project_sha256() -> str:
    """Hash of the code of this project that plans depend on."""
    root = Path(__file__).parents[2]
    excluded = tuple(root / folder for folder in APART)
    files = {
        path.relative_to(root).as_posix(): path
        for package in OURS
        for path in (root / package).rglob("*.py")
        if not any(path.is_relative_to(folder) for folder in excluded)
    }
    contents = {name: path.read_bytes() for name, path in sorted(files.items())}
    # Parsing all of it takes a second, reading it little.
    kept: ResultStore[str] = ResultStore(cache_root() / "code", str)
    bytes_of = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    key = content_key("project", sys.version_info[:2], bytes_of)
    sha256 = kept.get(key)
    if sha256 is None:
        sha256 = content_key([(name, _tree_sha256(content, _parsed(content))) for name, content in contents.items()])
        with contextlib.suppress(InputError):
            kept.put(key, sha256)
    return sha256


def hash_loaded_code() -> dict[str, str]:
    """Hashes of files that this process has loaded modules from, beside Python's, libraries' and this project's."""
    names = [name for name in list(sys.modules) if name.partition(".")[0] not in _NO_STRANGERS]
    files = {file for file in map(_own_file, names) if file is not None}
    return {str(file): file_code_sha256(file) for file in sorted(files)}


def is_current(loaded: Mapping[str, str]) -> bool:
    """Whether files that `hash_loaded_code` named still say the same."""
    return all(Path(file).is_file() and file_code_sha256(Path(file)) == sha256 for file, sha256 in loaded.items())


def hash_modules(start: Iterable[str], made: type | None = None) -> dict[str, str]:
    """Hashes by name of modules and of all that they import, directly and through others, and that counts.

    The top-level package of the class ``made`` counts wherever it is installed.
    """
    top_package = "" if made is None else made.__module__.partition(".")[0]
    hashes: dict[str, str] = {}
    waiting = sorted(set(start))
    while waiting:
        module = waiting.pop()
        name = "__main__" if module == "__mp_main__" else module
        if name in hashes:
            continue
        file = _located(module) if top_package and module.partition(".")[0] == top_package else _own_file(module)
        if file is None or _is_in_project_hash(file):
            continue
        hashes[name], imports = _code(file)
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        waiting += [parent for imported in imports for parent in _with_parents(_absolute(imported, package))]
    return hashes


def file_code_sha256(path: Path) -> str:
    """Hash of the syntax tree of a file as it is now, without what says nothing."""
    return _code(path)[0]


def _code(path: Path) -> tuple[str, tuple[str, ...]]:
    """The hash of a file, and the names that its import statements name; relative ones begin with dots."""
    state = path.stat()
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4096)
def _read(path: Path, changed_ns: int, size: int) -> tuple[str, tuple[str, ...]]:
    content = path.read_bytes()
    tree = _parsed(content)
    return _tree_sha256(content, tree), () if tree is None else tuple(sorted(set(_imports(tree))))


def _parsed(content: bytes) -> ast.Module | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(content)
    except (SyntaxError, ValueError, RecursionError):
        return None


def _tree_sha256(content: bytes, tree: ast.Module | None) -> str:
    if tree is None:
        # Not Python of this version: only a change of its bytes can be detected.
        return hashlib.sha256(content).hexdigest()
    words: list[str] = []
    _write(tree, words)
    return hashlib.sha256(" ".join(words).encode("utf-8", "backslashreplace")).hexdigest()


def _write(node: ast.AST, words: list[str]) -> None:
    """Write a syntax tree down; what is absent is left out, as newer versions of Python have more fields."""
    words.append(type(node).__name__)
    for name in node._fields:
        value = getattr(node, name, None)
        if name in _SAYS_NOTHING or value is None or value == []:
            continue
        words.append(name)
        for child in value if isinstance(value, list) else (value,):
            if not isinstance(child, ast.AST):
                words.append(repr(child))
            # Docstrings, and placeholders such as `...`.
            elif not isinstance(child, ast.Pass) and not (
                isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            ):
                _write(child, words)
    words.append(")")


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in _run_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            yield module
            yield from (f"{module}{'.' if node.module else ''}{alias.name}" for alias in node.names)


def _run_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those that only type checkers read."""
    for child in ast.iter_child_nodes(node):
        name = getattr(child.test, "attr", getattr(child.test, "id", "")) if isinstance(child, ast.If) else ""
        for branch in child.orelse if isinstance(child, ast.If) and name == "TYPE_CHECKING" else [child]:
            yield branch
            yield from _run_nodes(branch)


def _absolute(name: str, package: str) -> str:
    level = len(name) - len(name.lstrip("."))
    if not level:
        return name
    parents = package.split(".")
    return ".".join([*parents[: len(parents) - level + 1], *filter(None, [name.lstrip(".")])])


def _with_parents(module: str) -> list[str]:
    """Importing a module imports the packages that it lies in."""
    parts = module.split(".")
    return [".".join(parts[: end + 1]) for end in range(len(parts))]


def _own_file(module: str) -> Path | None:
    """The file of a module that is neither Python's nor an installed library's."""
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names or top in _LIBRARIES:
        return None
    file = _located(module)
    return None if file is None or _INSTALLED & set(file.parts) or _is_in_project_hash(file) else file


def _is_in_project_hash(file: Path) -> bool:
    """Whether a file is this project's, and no extension's."""
    root = Path(__file__).parents[2]
    parts = file.relative_to(root).parts if file.is_relative_to(root) else ("",)
    return parts[0] in OURS and "extensions" not in parts


def _located(module: str) -> Path | None:
    """The source file of a module; nothing is imported to find it."""
    if module in sys.modules:
        return _python_file(getattr(sys.modules[module], "__file__", None))
    spec = _spec(module)
    return None if spec is None else _python_file(spec.origin)


def _spec(module: str) -> ModuleSpec | None:
    parent = module.rpartition(".")[0]
    folders: Any = None
    if parent in sys.modules:
        folders = getattr(sys.modules[parent], "__path__", [])
    elif parent:
        above = _spec(parent)
        folders = [] if above is None else above.submodule_search_locations or []
    try:
        return PathFinder.find_spec(module, None if folders is None else list(folders))
    except (ImportError, ValueError):
        return None


def _python_file(name: Any) -> Path | None:
    path = Path(name) if isinstance(name, str) and name.endswith(".py") else None
    return path if path is not None and path.is_file() else None


def _source_of(made: type) -> Path | None:
    try:
        return _python_file(inspect.getsourcefile(made))
    except (TypeError, OSError):
        return None
