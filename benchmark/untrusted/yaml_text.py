"""Foreign YAML: small files of settings that people write by hand."""

from pathlib import Path
from typing import Any

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line, read_file
from benchmark.untrusted.limits import SETTINGS, Limits


def read_yaml(path: Path, limits: Limits = SETTINGS) -> Any:
    """Read a YAML file of plain values: no tags, and no aliases, of which a few lines can make billions of values.

    Args:
        path: The file.
        limits: How large it may be, and how deep its containers may lie.

    Returns:
        Its value.

    Raises:
        InputError: If it is absent, unreadable, too large, nested too deeply or not such YAML.
    """
    import yaml

    class PlainLoader(yaml.SafeLoader):  # type: ignore[misc]
        """Loader that refuses aliases and deep nesting while it reads."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("it has an alias; write the value out")
            self.depth += 1
            if self.depth > limits.depth:
                raise yaml.YAMLError(f"its containers lie more than {limits.depth} deep")
            try:
                return super().compose_node(parent, index)
            finally:
                self.depth -= 1

    try:
        return yaml.load(read_file(path, limits).decode("utf-8-sig"), Loader=PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is not valid YAML ({one_line(error) or 'nested too deeply'}); correct it") from error
