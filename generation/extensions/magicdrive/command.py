"""The renderer as the command line asks for it, and where its scenes are drawn."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import torch

from benchmark.machine.devices import select_device
from benchmark.machine.ray_cluster import RayCluster
from benchmark.machine.workers import Executor, LocalProcesses
from generation.extensions.magicdrive.prompt import PromptLook
from generation.extensions.magicdrive.renderer import MagicDriveRenderer, RenderSettings
from generation.extensions.magicdrive.sensor_frames import ImageGeometry, OutputSize
from generation.extensions.magicdrive.weights import NetworkFiles


def build_magicdrive_renderer(
    work: Path,
    weights: Path | None,
    *,
    drawn_size: str = "224x400",
    written_size: str = "1600x900",
    look: str = "recorded",
    device: str = "auto",
    seed: int = 0,
    tera_operations: float | None = None,
    estimates_only: bool = False,
) -> MagicDriveRenderer:
    """The published network, ready to draw; nothing is loaded.

    Args:
        work: Folder for what is kept between stages.
        weights: Folder of the published weights, or ``None`` for the cache.
        drawn_size: Output size of the network, HEIGHTxWIDTH.
        written_size: ``1600x900``, or ``model`` for the size that is drawn.
        look: One of `PromptLook`.
        device: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` for GPUs where there are any.
        seed: Of noise and of the looks of objects.
        tera_operations: Operations that the device does in a second, 10^12, for estimates; measured by default.
        estimates_only: Whether nothing will be drawn, so that weights are not looked for.

    Returns:
        The renderer.

    Raises:
        InputError: If weights are missing: what to get, where, how big.
    """
    height, width = (int(side) for side in drawn_size.split("x"))
    settings = RenderSettings(
        geometry=ImageGeometry(height, width, cast(OutputSize, written_size)),
        look=PromptLook(look),
        seed=seed,
        device=device,
        tera_operations=tera_operations,
    )
    return MagicDriveRenderer(settings, None if estimates_only else NetworkFiles.find(weights), work)


def build_rendering_executor(place: Executor, device: str) -> Executor:
    """Executor of the drawing on ``auto``, ``cpu``, ``cuda`` (all GPUs) or ``cuda:1``: one scene at a time on each GPU.

    As many processes as there are GPUs, but no more than were asked for; on a Ray cluster units with a GPU each;
    ``place`` itself where the network runs on processors.
    """
    on_gpu = device.startswith("cuda") or (device == "auto" and torch.cuda.is_available())
    if isinstance(place, RayCluster):
        return replace(place, gpus=1) if on_gpu else place
    torch_device = select_device(device)
    if torch_device.type != "cuda" or not isinstance(place, LocalProcesses):
        return place
    return LocalProcesses(1 if torch_device.index is not None else min(place.workers, torch.cuda.device_count()))
