"""``generate --renderer magicdrive``: the renderer from the options of the command, where it can run."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmark.cli.generate_options import GenerateOptions
    from benchmark.machine.workers import Executor
    from generation.extensions.magicdrive.renderer import MagicDriveRenderer


@dataclass(frozen=True, slots=True)
class PhotorealisticOptions:
    """Options of the renderer, as `generation.extensions.magicdrive.command.build_magicdrive_renderer` has them."""

    weights: Path | None
    drawn_size: str
    written_size: str
    look: str
    device: str
    seed: int
    tera_operations: float | None
    estimates_only: bool

    def require(self) -> None:
        """Raise `InputError` for a device that is none, and where weights or packages are absent that it draws with."""
        from benchmark.api import require_device
        from benchmark.machine.extension import require_package
        from benchmark.machine.path_checks import require_folder

        require_device(self.device)
        require_folder(self.weights, "--weights-folder")
        if not self.estimates_only:
            from generation.extensions.magicdrive.weights import NetworkFiles

            NetworkFiles.find(self.weights)
            for package in ("diffusers", "transformers"):
                extra = "install it with: pip install 'challenger-bench[render]'"
                require_package(package, f"the renderer magicdrive needs the package {package}; {extra}")

    def renderer(self, work: Path) -> "MagicDriveRenderer":
        """The renderer; ``work`` is its folder for what is kept between stages."""
        from generation.extensions.magicdrive.command import build_magicdrive_renderer

        return build_magicdrive_renderer(
            work,
            self.weights,
            drawn_size=self.drawn_size,
            written_size=self.written_size,
            look=self.look,
            device=self.device,
            seed=self.seed,
            tera_operations=self.tera_operations,
            estimates_only=self.estimates_only,
        )

    def executor(self, place: "Executor") -> "Executor | None":
        """Executor of the drawing; estimates for a GPU are wanted on machines that have none."""
        from generation.extensions.magicdrive.command import build_rendering_executor

        return None if self.estimates_only else build_rendering_executor(place, self.device)


def read_photorealistic_options(options: "GenerateOptions") -> PhotorealisticOptions:
    """Those of ``generate`` that are the renderer's."""
    return PhotorealisticOptions(
        options.weights_folder,
        drawn_size=options.render_size,
        written_size=options.written_size,
        look=options.prompt_look,
        device=options.render_device,
        seed=options.seed,
        tera_operations=options.tflops,
        estimates_only=options.dry_run,
    )
