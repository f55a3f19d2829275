"""Pictures of recordings on a site: whose they are, and whether somebody said that they may be shown."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

from benchmark.errors import InputError
from leaderboard.extensions.publishing.findings import Found
from leaderboard.site.scripts import script_data

INDEX: Final = "data/index.js"
DRAWN: Final = ("schematic", "schematic-restyled")
"""Renderers that draw boxes and maps; no pixel is of a recording."""
_NAMED: Final = 3


def pictures_of_recordings(
    root: str, read: Mapping[str, str], there: Collection[str], may_show: Collection[str]
) -> Iterator[Found]:
    """Findings of camera pictures that are not said to be showable, one for each data set, split and renderer.

    Or that it cannot be told. `root` is the path of the site below the folder, with a slash at its end, or empty;
    `read` are texts of its scripts by path below the folder.
    """
    taken = {
        file.removeprefix(f"{root}media/").partition("/")[0]
        for file in there
        if file.startswith(f"{root}media/") and "/cameras/" in file
    }
    if not taken:
        return
    index = f"{root}{INDEX}"
    try:
        scenes = script_data(read[index])["scenes"]
        known = {str(scene["key"]): scene for scene in scenes}
        rows = [known[key] for key in sorted(taken)]
        groups: dict[tuple[str, str, str | None], list[str]] = defaultdict(list)
        for row in rows:
            groups[str(row["data"]), str(row["split"]), _renderer(row)].append(str(row["scene"]))
    except (InputError, KeyError, TypeError):
        yield Found(index, 0, "picture", "pictures of cameras lie below media/, and it does not say whose they are")
        return
    for (data, split, drawn_by), names in sorted(
        groups.items(), key=lambda one: (one[0][0], one[0][1], one[0][2] or "")
    ):
        if drawn_by in DRAWN or data in may_show:
            continue
        maker = f"drawn by {drawn_by} from recordings" if drawn_by else "taken by cameras as far as is known"
        some = ", ".join(sorted(names)[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
        yield Found(
            f"{root}media",
            0,
            "picture",
            f"pictures of {len(names)} scenes of {data}, split {split} ({some}), {maker}: read the licence of the "
            f"recordings; if it allows to show them, name the data set with --may-show {data}, else write the sheets "
            "anew with --pictures none",
        )


def _renderer(row: Mapping[str, Any]) -> str | None:
    said = row.get("drawnBy")
    return said if isinstance(said, str) else None
