"""Pages of the reference of Python: every name of the public face, with its docstring where it is defined."""

import benchmark

PACKAGES = {
    "benchmark": "Data sets, evaluation, drives, records and rates.",
    "generation": "Adversarial scenes, the embedded town, frozen splits, renderers.",
    "adapters": "Planners, plan files, result files, weights and training.",
    "leaderboard": "Tables, figures, films.",
}


def defined_in() -> dict[str, str]:
    """Where each name of the public face is defined, as ``module.name``; nothing is imported."""
    face: dict[str, str] = vars(benchmark)["_PLACES"]
    return {name: place.replace(":", ".") for name, place in sorted(face.items())}


def face_pages() -> dict[str, str]:
    """Markdown of one page for each package, and of one that lists all names, by address."""
    pages = {"python-reference/index.md": _overview()}
    for package, about in PACKAGES.items():
        lines = [f"# Python: {package}", "", f"{about} All of it is found in `benchmark`, under the names here.", ""]
        for name, place in defined_in().items():
            if place.startswith(f"{package}."):
                lines += [f"## {name} {{ #{name} }}", "", f"`benchmark.{name}`", "", f"::: {place}", ""]
        pages[f"python-reference/{package}.md"] = "\n".join(lines)
    return pages


def _overview() -> str:
    """The list of all names, a row a package."""
    rows = []
    for package, about in PACKAGES.items():
        names = [name for name, place in defined_in().items() if place.startswith(f"{package}.")]
        links = ", ".join(f"[`{name}`]({package}.md#{name})" for name in names)
        rows += [f"## {package}", "", about, "", links, ""]
    head = ["# Python: all names", "", "What each is for, with examples: [From Python](../python.md).", ""]
    return "\n".join([*head, *rows])
