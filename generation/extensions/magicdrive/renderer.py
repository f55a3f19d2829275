"""Photorealistic renderer: MagicDriveDiT draws a scene as six videos from the published weights.

Slow stages are kept on disk, so that a killed command goes on. T5 v1.1 XXL is loaded for the words of a scene and let
go of again (section 4.1).
"""

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.devices import select_device, select_worker_device
from benchmark.machine.storage import content_key, content_seed, sanitise_file_name, writing_to
from benchmark.machine.workers import worker_number
from benchmark.scene import Camera, EgoTrack, Scene
from benchmark.weights.pretrained import OptionalLibrary
from generation.extensions.magicdrive.checkpoint import VideoDecoder, load_published_network
from generation.extensions.magicdrive.clip import MOST_FRAMES, Clip, build_clip, compute_published_length, pad_frames
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS, TEXT_TOKENS, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.estimate import RenderingEstimate, estimate_rendering_stages, measure_speed
from generation.extensions.magicdrive.layers import unpack_views
from generation.extensions.magicdrive.model import MagicDriveDiT
from generation.extensions.magicdrive.prompt import PromptLook, build_prompt
from generation.extensions.magicdrive.sampling import (
    SamplingOptions,
    SamplingState,
    cache_tensor,
    draw_first_state,
    read_cached_tensor,
    sample_latents,
)
from generation.extensions.magicdrive.sensor_frames import ImageGeometry, build_camera_tracks, find_model_order
from generation.extensions.magicdrive.weights import NetworkFiles
from generation.nuscenes_writer.plan import to_digestible
from generation.render.contract import Images, require_frames

TRANSFORMERS: Final = OptionalLibrary("transformers", extra="render", needed_by="the renderer magicdrive")


class T5TextEncoder:
    """The published text encoder, in single precision as the published scripts use it."""

    def __init__(self, folder: Path, device: torch.device, tokens: int = TEXT_TOKENS) -> None:
        """Load configuration, weights and vocabulary (needs transformers); prompts are padded or cut to ``tokens``."""
        self._tokens, self._device = tokens, device
        self._tokenizer: Any = TRANSFORMERS.load("AutoTokenizer", folder)
        self._network: Any = TRANSFORMERS.load("T5EncoderModel", folder, use_safetensors=False).to(device)

    @torch.no_grad()
    def encode(self, prompt: str) -> TextStates:
        """Hidden states of a prompt as it is, padded or cut, and which of them belong to words, on the processor."""
        words = self._tokenizer(
            prompt,
            max_length=self._tokens,
            padding="max_length",
            truncation=True,
            return_attention_mask=True,
            return_tensors="pt",
        ).to(self._device)
        hidden = self._network(input_ids=words["input_ids"], attention_mask=words["attention_mask"])
        return TextStates(hidden.last_hidden_state[0].float().cpu(), words["attention_mask"][0].bool().cpu())


RENDERER_VERSION: Final = 1
_KEEP_EVERY_STEPS: Final = 5


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """Settings of a drawing.

    Noise and looks of objects depend on `seed` and the recorded scene, not on who drives adversarially in it, so that a
    scene and its variants look alike. `device` is ``cpu``, ``cuda`` (with several workers all GPUs), ``cuda:1``, or
    ``auto`` for GPUs where there are any. `tera_operations`, 10^12 a second, are for estimates; measured by default.
    """

    geometry: ImageGeometry = field(default_factory=ImageGeometry)
    look: PromptLook = PromptLook.RECORDED
    seed: int = 0
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    device: str = "auto"
    tera_operations: float | None = None


class MagicDriveRenderer:
    """Draws a scene as MagicDriveDiT imagines it; see `generation.render.contract.Renderer`.

    Conditions of both branches are encoded once a scene. The text encoder is loaded for words that were not encoded
    before and let go of; transformer and decoder stay for the next scene. Views are decoded one after the other.
    """

    name = "magicdrive"

    def __init__(
        self,
        settings: RenderSettings,
        files: NetworkFiles | None,
        work: Path,
        config: MagicDriveConfig | None = None,
    ) -> None:
        """Say what is drawn with what; nothing is loaded. Without ``files`` there are estimates only.

        ``work`` keeps tensors between stages; only the speed of later commands depends on it.
        """
        self.settings, self.files, self.work = settings, files, work
        self.config = config or MagicDriveConfig.full()
        # A named device is not checked with PyTorch: on a cluster the machine of the command may have none.
        named = settings.device.startswith("cuda")
        self._on_gpu = named or (settings.device == "auto" and torch.cuda.is_available())

    @property
    def version(self) -> str:
        """Everything that the pictures depend on beside the scene, in words; weights by their hash."""
        settings, files = self.settings, self.files
        sampling = settings.sampling
        weights = None if files is None else [files.fingerprint, files.text_fingerprint]
        details = content_key(weights, to_digestible(sampling), to_digestible(self.config))[:12]
        precision = str(self._dtype).removeprefix("torch.")
        return (
            f"{RENDERER_VERSION}, {settings.geometry.height}x{settings.geometry.width}, {settings.look.value}, seed "
            f"{settings.seed}, {sampling.steps} steps, guidance {sampling.guidance:g} ({sampling.mode}), "
            f"{precision} on {'cuda' if self._on_gpu else 'cpu'}, weights and details {details}"
        )

    @property
    def _dtype(self) -> torch.dtype:
        return torch.bfloat16 if self._on_gpu else torch.float32

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """The six cameras that are drawn, with the calibration of what is written."""
        return tuple(self.settings.geometry.camera(scene.cameras[index]) for index in sorted(find_model_order(scene)))

    def cut(self, scene: Scene) -> Scene:
        """The scene in the length of the published data sets (`compute_published_length`)."""
        count = len(scene.timestamps_us)
        length = compute_published_length(count)
        return scene if length == count else scene.first_frames(length)

    def camera_tracks(self, scene: Scene) -> Mapping[str, EgoTrack]:
        """Tracks of the ego at the times of each camera: the model draws what a camera saw at its own sweep."""
        return build_camera_tracks(scene)

    def estimate(self, scene: Scene) -> RenderingEstimate:
        """Operations, seconds and memory of a scene by stage; needs no weights. Its end is left out as `cut` does."""
        scene = self.cut(scene)
        _require_drawable(scene)
        settings = self.settings
        prompt = build_prompt(scene, settings.look)
        stages = estimate_rendering_stages(
            scene,
            settings.geometry,
            self.config,
            steps=settings.sampling.steps,
            words=prompt.positive,
            dtype=self._dtype,
        )
        speed = settings.tera_operations
        if speed is None:
            speed = measure_speed(select_device(settings.device), self._dtype, self.config.hidden)
        return RenderingEstimate(
            frames=len(scene.timestamps_us),
            size=(settings.geometry.height, settings.geometry.width),
            stages=stages,
            device="a GPU" if self._on_gpu else "the processor",
            tera_operations=speed,
            measured=settings.tera_operations is None,
        )

    def estimate_sentence(self, scene: Scene) -> str:
        """The estimate in words."""
        return self.estimate(scene).plain()

    def scene_seconds(self, scene: Scene) -> float:
        """About how long a scene takes."""
        return self.estimate(scene).seconds

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        """Draw a scene, and give some of its frames.

        Args:
            scene: The scene; all of its frames are drawn, because the model draws videos.
            frames: Frame indices in ``scene.timestamps_us``.

        Yields:
            RGB images by camera name, for each frame in order.

        Raises:
            InputError: If a frame is not in the scene, the scene is too long, weights are missing or damaged, or the
                device has too little memory.
        """
        _require_drawable(scene)
        require_frames(scene, frames)
        if not len(frames):
            return
        geometry = self.settings.geometry
        clip = build_clip(
            scene,
            pad_frames(range(len(scene.timestamps_us))),
            height=geometry.height,
            width=geometry.width,
            look=self.settings.look,
        )
        drawing = _SceneVideos(self, clip)
        videos = drawing.videos()
        for frame in frames:
            yield {name: geometry.picture(video[frame]) for name, video in videos.items()}
        drawing.remove_videos()


def _require_drawable(scene: Scene) -> None:
    find_model_order(scene)
    count = len(scene.timestamps_us)
    if count > MOST_FRAMES:
        raise InputError(
            f"{scene.name} has {count} frames; MagicDriveDiT draws at most {MOST_FRAMES} (20 s at 12 Hz), cut the scene"
        )


class _SceneVideos:
    """One scene on its way from conditions to videos."""

    def __init__(self, renderer: MagicDriveRenderer, clip: Clip) -> None:
        if renderer.files is None:
            raise InputError("the renderer was made for estimates; give it weights to draw")
        self._settings, self._config, self._files = renderer.settings, renderer.config, renderer.files
        self._work, self._dtype = renderer.work, renderer._dtype
        self._clip = clip
        self._key = content_key("latents and videos", renderer.version, to_digestible(clip))
        self._folder = renderer.work / "scenes" / f"{sanitise_file_name(clip.scene)}-{self._key[:16]}"
        self._device = select_worker_device(renderer.settings.device, worker_number())

    def videos(self) -> dict[str, NDArray[np.uint8]]:
        """(T, height, width, 3) by camera; those that were decoded before are read."""
        by_camera: dict[str, NDArray[np.uint8]] = {}
        latent: Tensor | None = None
        for view, camera in enumerate(MODEL_CAMERAS):
            cached = read_cached_tensor(self._video_path(camera), self._key)
            if cached is None:
                with _deterministic_kernels(self._device, self._clip.scene):
                    latent = self._sample_latent() if latent is None else latent
                    decoder = _load_decoder(self._files.autoencoder, self._device, self._dtype)
                    video = decoder.frames(unpack_views(latent, len(MODEL_CAMERAS))[0, view])
                cache_tensor(self._video_path(camera), self._key, video)
            else:
                video = cached[0]
            by_camera[camera] = np.asarray(video.numpy())
        return by_camera

    def remove_videos(self) -> None:
        """Remove what can be decoded again in no time; latents stay, so that another output size costs little."""
        for camera in MODEL_CAMERAS:
            path = self._video_path(camera)
            with writing_to(path):
                path.unlink(missing_ok=True)

    def _video_path(self, camera: str) -> Path:
        return self._folder / f"{camera}.safetensors"

    def _sample_latent(self) -> Tensor:
        """(1, 96, t, h, w), sampled from where an earlier command was killed."""
        path, options = self._folder / "latent.safetensors", self._settings.sampling
        state = SamplingState.load(path, self._key)
        if state is not None and state.step == options.steps:
            return state.latent
        text, negative = self._words()
        seed = content_seed("magicdrive", self._clip.scene, self._settings.seed)
        conditions = self._clip.conditions(text, negative, latent_width=self._config.hidden, seed=seed)
        network = _load_transformer(self._files.transformer, self._config, self._device, self._dtype)

        def keep(state: SamplingState) -> None:
            if state.step % _KEEP_EVERY_STEPS == 0 or state.step == options.steps:
                state.save(path, self._key)

        start = state or draw_first_state(network, conditions, seed)
        latent = sample_latents(network, conditions, start, options, on_step=keep).cpu()
        _free_memory(self._device)
        return latent

    def _words(self) -> tuple[TextStates, TextStates | None]:
        """Prompt and negative prompt through the text encoder; those that were encoded before are read."""
        prompt, tokens = self._clip.prompt, self._config.text_tokens
        encoder: T5TextEncoder | None = None
        encoded: list[TextStates] = []
        for words in (prompt.positive, prompt.negative):
            if words is None:
                continue
            key = content_key("words", words, self._files.text_fingerprint, tokens, self._device.type)
            path = self._work / "words" / f"{key[:32]}.safetensors"
            cached = read_cached_tensor(path, key)
            if cached is None:
                encoder = encoder or T5TextEncoder(self._files.text_encoder, self._device, tokens)
                states = encoder.encode(words)
                cache_tensor(path, key, states.hidden, {"words": int(states.mask.sum())})
            else:
                states = TextStates(cached[0], torch.arange(len(cached[0])) < cached[1]["words"])
            encoded.append(states)
        if encoder is not None:
            # Its parts refer to each other, and there are 19 GB of them.
            encoder = None
            gc.collect()
            _free_memory(self._device)
        return encoded[0], encoded[1] if len(encoded) > 1 else None


@lru_cache(maxsize=1)
def _load_transformer(path: Path, config: MagicDriveConfig, device: torch.device, dtype: torch.dtype) -> MagicDriveDiT:
    return load_published_network(path, config, device=device, dtype=dtype)


@lru_cache(maxsize=1)
def _load_decoder(folder: Path, device: torch.device, dtype: torch.dtype) -> VideoDecoder:
    return VideoDecoder.load(folder, device, dtype)


def _free_memory(device: torch.device) -> None:
    """Give memory that nothing refers to back to the device, for the next network."""
    if device.type == "cuda":
        torch.cuda.empty_cache()


@contextmanager
def _deterministic_kernels(device: torch.device, scene: str) -> Iterator[None]:
    """The same kernels every time, and a sentence where memory runs out."""
    try:
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True):
            yield
    except torch.cuda.OutOfMemoryError as error:
        raise InputError(
            f"{scene} does not fit into the memory of {device}; see what each stage needs with --dry-run, free the GPU "
            "of other work or choose a smaller --render-size (finished work is kept)"
        ) from error
