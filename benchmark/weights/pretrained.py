"""Networks of other people's libraries from folders on this machine; nothing is ever fetched on the way."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmark.errors import InputError
from benchmark.report.words import pluralise
from benchmark.untrusted.arrays import require_sound_header
from benchmark.untrusted.checkpoints import read_stored
from benchmark.untrusted.files import LIBRARY_CHECKPOINT


@dataclass(frozen=True, slots=True)
class OptionalLibrary:
    """A library that only some commands need."""

    name: str
    extra: str
    needed_by: str

    def load(self, kind: str, folder: Path, **settings: Any) -> Any:
        """An object of a class of the library with the files of a folder, by ``from_pretrained`` with the settings.

        A network is in evaluation mode on the processor, in single precision if they say nothing.
        """
        loader = getattr(self.imported(), kind)
        # What `torch.device` concerns is listed once, at its first use. Transformers replaces one of these functions
        # (linspace) while it loads: a list made then would lack it for the rest of the process.
        with torch.device("cpu"):
            torch.empty(0)
        try:
            if not issubclass(loader, torch.nn.Module):
                return loader.from_pretrained(folder, local_files_only=True, **settings)
            _require_sound_weights(folder)
            network, report = loader.from_pretrained(
                folder,
                local_files_only=True,
                output_loading_info=True,
                **{"use_safetensors": True, "dtype": torch.float32, **settings},
            )
        # A damaged configuration or tokenizer may raise anything.
        except Exception as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise InputError(
                f"{folder} does not hold a {kind} that can be loaded ({reason}); get it again (challenger-bench "
                "weights list)"
            ) from error
        missing = sorted(report["missing_keys"])
        if missing:
            raise InputError(
                f"the weights in {folder} lack {pluralise(len(missing), 'tensor')} of {kind} (first: {missing[0]}); "
                "get them again (challenger-bench weights list)"
            )
        return network.eval()

    def version(self) -> str:
        """Its version; raises `InputError` where it is not installed."""
        return str(self.imported().__version__)

    def imported(self) -> Any:
        """The module; raises `InputError` where it is not installed."""
        try:
            library = importlib.import_module(self.name)
        except ImportError as error:
            raise InputError(
                f"{self.needed_by} needs the package {self.name}; install it with: pip install "
                f"'challenger-bench[{self.extra}]'"
            ) from error
        # Progress bars and hints of the library are hidden from users of a benchmark.
        logging = importlib.import_module(f"{self.name}.utils.logging")
        logging.set_verbosity_error()
        logging.disable_progress_bar()
        return library


def _require_sound_weights(folder: Path) -> None:
    """Take every file of weights apart as the door does, before a library reads it."""
    for path in sorted(folder.glob("*.bin")):
        read_stored(path, LIBRARY_CHECKPOINT, checksums=False)
    for path in sorted(folder.glob("*.safetensors")):
        require_sound_header(path)
