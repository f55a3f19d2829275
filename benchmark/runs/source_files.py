"""Python files as data: what each definition says, which names it uses, and what import statements make of the names.

Nothing is imported or run. What a definition says is its syntax tree without docstrings, comments and import lines,
written the same way by every version of Python.
"""

import ast
import hashlib
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final

ON_IMPORT: Final = ""
"""Stands for the statements of a module that are no definition: what importing it does."""
_DEFINING = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_SAYS_NOTHING: Final = frozenset({"ctx", "type_comment", "kind"})
_OUTSIDE: Final = "outside_identity"


@dataclass(frozen=True, slots=True)
class Import:
    """What an import statement makes of a name.

    Attributes:
        module: The module, absolute.
        name: The name in it; ``None`` for the module itself.
    """

    module: str
    name: str | None = None


@dataclass(slots=True)
class Reading:
    """What some statements say.

    Attributes:
        text: Their syntax trees.
        uses: Names, each with the attributes that are read from it: ``np.linalg.norm`` is ("np", "linalg", "norm").
        strings: Text in them.
        imports: What the import statements among them make of names.
        modules: Modules that they import, parents left out.
    """

    text: str = ""
    uses: set[tuple[str, ...]] = field(default_factory=set)
    strings: set[str] = field(default_factory=set)
    imports: defaultdict[str, set[Import]] = field(default_factory=lambda: defaultdict(set))
    modules: set[str] = field(default_factory=set)

    @property
    def sha256(self) -> str:
        """Of the text."""
        return hashlib.sha256(self.text.encode("utf-8", "backslashreplace")).hexdigest()


class SourceFile:
    """The top level of one file.

    Args:
        path: The file.
        module: Name of its module.

    Attributes:
        package: Which the module is in, or is.
        definitions: Statements by the name they define; those that define none under `ON_IMPORT`.
        outside: Definitions that are marked with `outside_identity`.
        imports: What import statements outside definitions make of names.
        modules: Modules that importing this one imports.
    """

    def __init__(self, path: Path, module: str) -> None:
        self.package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        self.definitions: defaultdict[str, list[ast.stmt]] = defaultdict(list)
        self._readings: dict[str, Reading] = {}
        content = path.read_bytes()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tree = ast.parse(content)
        except (SyntaxError, ValueError, RecursionError):
            # Not Python of this version: all that can be said is whether it changed.
            tree = ast.parse(f"__file__ = {hashlib.sha256(content).hexdigest()!r}")
        on_import: list[ast.stmt] = []
        for statement in _flattened(tree.body):
            names = _defined(statement)
            for name in names:
                self.definitions[name].append(statement)
            if not names:
                on_import.append(statement)
        for statement in on_import:
            for name in sorted(set(_bound_within(statement))):
                self.definitions[name].append(statement)
        self.definitions[ON_IMPORT] = on_import
        self.outside = frozenset(name for name, said in self.definitions.items() if any(map(_is_outside, said)))
        first = self.read(ON_IMPORT)
        self.imports, self.modules = first.imports, first.modules

    def read(self, name: str) -> Reading:
        """What a definition says.

        Args:
            name: Of the definition.

        Returns:
            Its statements in order, read once.
        """
        if name not in self._readings:
            self._readings[name] = _Reader(self.package).reading(self.definitions[name])
        return self._readings[name]


def source_file(path: Path, module: str) -> SourceFile | None:
    """A file as it is now, read once as long as it stays the same.

    Args:
        path: The file.
        module: Name of its module.

    Returns:
        The file, or ``None`` if it cannot be read.
    """
    try:
        state = path.stat()
        return _read(path, module, state.st_mtime_ns, state.st_size)
    except OSError:
        return None


@lru_cache(maxsize=4096)
def _read(path: Path, module: str, changed_ns: int, size: int) -> SourceFile:
    return SourceFile(path, module)


class _Reader:
    """Writes statements down and notes the names that they use."""

    def __init__(self, package: str) -> None:
        self._package = package
        self._parts: list[str] = []
        self._found = Reading()

    def reading(self, body: Iterable[ast.AST]) -> Reading:
        """What some statements say, one after the other."""
        self._value(list(body))
        self._found.text = " ".join(self._parts)
        return self._found

    def _node(self, node: ast.AST) -> None:
        if isinstance(node, ast.Import | ast.ImportFrom):
            self._import(node)
        elif isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            # Docstrings, and what stands where there is nothing to say.
            return
        elif isinstance(node, ast.If) and _never_runs(node.test):
            self._value(node.orelse)
        elif isinstance(node, ast.Attribute) and (chain := _chain(node)):
            self._found.uses.add(chain)
            self._parts.append(".".join(chain))
        else:
            self._fields(node)

    def _fields(self, node: ast.AST) -> None:
        if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Store):
            self._found.uses.add((node.id,))
        elif isinstance(node, ast.AugAssign) and (name := _last_name(node.target)):
            self._found.uses.add((name,))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            self._found.strings.add(node.value)
        self._parts.append(f"({type(node).__name__}")
        for name in node._fields:
            value = getattr(node, name, None)
            # What is absent is left out: newer versions of Python have more fields.
            if name not in _SAYS_NOTHING and value is not None and value != []:
                self._parts.append(name)
                self._value(_methods_by_name(value) if isinstance(node, ast.ClassDef) and name == "body" else value)
        self._parts.append(")")

    def _value(self, value: object) -> None:
        if isinstance(value, ast.AST):
            self._node(value)
        elif isinstance(value, list):
            for each in value:
                self._value(each)
        else:
            self._parts.append(repr(value))

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        found = self._found
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = alias.name.partition(".")[0]
                found.imports[alias.asname or top].add(Import(alias.name if alias.asname else top))
                found.modules.add(alias.name)
            return
        module = _absolute(node.module or "", node.level, self._package)
        found.modules.add(module)
        for alias in node.names:
            found.imports[alias.asname or alias.name].add(Import(module, alias.name))
            found.modules.add(f"{module}.{alias.name}")


def _absolute(module: str, level: int, package: str) -> str:
    if not level:
        return module
    parents = package.split(".")
    return ".".join([*parents[: len(parents) - level + 1], *([module] if module else [])])


def absolute_name(module: str, package: str) -> str:
    """A module's name that may be relative, with leading dots, as an absolute one."""
    name = module.lstrip(".")
    return _absolute(name, len(module) - len(name), package)


def _flattened(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """Top-level statements without blocks that never run when a module is imported."""
    for statement in body:
        if isinstance(statement, ast.If) and _never_runs(statement.test):
            yield from _flattened(statement.orelse)
        else:
            yield statement


def _never_runs(test: ast.expr) -> bool:
    """Whether a condition is ``TYPE_CHECKING`` or ``__name__ == "__main__"``."""
    if isinstance(test, ast.Compare):
        return _last_name(test.left) == "__name__" and isinstance(test.ops[0], ast.Eq)
    return _last_name(test) == "TYPE_CHECKING"


def _defined(statement: ast.stmt) -> list[str]:
    """Names that a statement does nothing but define."""
    if isinstance(statement, _DEFINING):
        return [statement.name]
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
        targets = [statement.target]
    elif isinstance(name := getattr(statement, "name", None), ast.Name):
        # ``type Name = ...``
        targets = [name]
    else:
        return []
    parts = [part for target in targets for part in _parts_of(target)]
    return [part.id for part in parts if isinstance(part, ast.Name)] if _all_names(parts) else []


def _parts_of(target: ast.expr) -> Iterator[ast.expr]:
    if isinstance(target, ast.Tuple | ast.List):
        for part in target.elts:
            yield from _parts_of(part)
    else:
        yield target.value if isinstance(target, ast.Starred) else target


def _all_names(parts: Iterable[ast.expr]) -> bool:
    return all(isinstance(part, ast.Name) for part in parts)


def _bound_within(statement: ast.stmt) -> Iterator[str]:
    """Names that a block, such as ``try``, may define."""
    for node in ast.walk(statement):
        if isinstance(node, _DEFINING):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def _methods_by_name(body: list[ast.stmt]) -> list[ast.stmt]:
    """The order of methods means nothing, unless they have one name."""
    others = [each for each in body if not isinstance(each, _FUNCTIONS)]
    return others + sorted((each for each in body if isinstance(each, _FUNCTIONS)), key=lambda each: each.name)


def _chain(node: ast.expr) -> tuple[str, ...] | None:
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return (node.id, *reversed(names)) if isinstance(node, ast.Name) else None


def _last_name(node: ast.expr) -> str | None:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else None


def _is_outside(statement: ast.stmt) -> bool:
    if isinstance(statement, _DEFINING):
        return any(_last_name(each) == _OUTSIDE for each in statement.decorator_list)
    value = getattr(statement, "value", None)
    return isinstance(value, ast.Call) and _last_name(value.func) == _OUTSIDE
