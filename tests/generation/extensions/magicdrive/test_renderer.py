"""The photorealistic renderer by its parts: geometry, words, decoding, going on, estimates, devices."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.machine.devices import select_worker_device
from benchmark.machine.ray_cluster import RayCluster
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.weights.catalogue import AUTOENCODER, TEXT_ENCODER, TRANSFORMER
from benchmark.weights.folders import require_folder_of
from generation.extensions.magicdrive import clip as clip_module
from generation.extensions.magicdrive import renderer as renderer_module
from generation.extensions.magicdrive.checkpoint import VideoDecoder
from generation.extensions.magicdrive.clip import compute_published_length
from generation.extensions.magicdrive.command import build_magicdrive_renderer, build_rendering_executor
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.prompt import PromptLook
from generation.extensions.magicdrive.renderer import MagicDriveRenderer, RenderSettings, T5TextEncoder
from generation.extensions.magicdrive.sampling import SamplingState, cache_tensor, read_cached_tensor
from generation.extensions.magicdrive.sensor_frames import ImageGeometry
from generation.extensions.magicdrive.weights import NetworkFiles
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.contract import Images
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene
from tests.generation.extensions.magicdrive.small_weights import (
    CONFIG,
    SIZE,
    brief_scene,
    small_renderer,
    write_weights,
)

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("published") / "weights")


@pytest.fixture(scope="module")
def drawn(weights: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Images]:
    return list(small_renderer(weights, tmp_path_factory.mktemp("work")).render(brief_scene(), range(7)))


def assert_same_pictures(found: list[Images], expected: list[Images]) -> None:
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.keys() == theirs.keys()
        for name, picture in theirs.items():
            np.testing.assert_array_equal(ours[name], picture)


@pytest.mark.parametrize(("height", "width", "cut_full_rows"), [(224, 400, 4), (424, 800, 52), (848, 1600, 52)])
def test_the_published_sizes_cut_the_published_rows(height: int, width: int, cut_full_rows: int) -> None:
    geometry = ImageGeometry(height, width, "1600x900")
    assert geometry.cut_rows / geometry.scale == pytest.approx(cut_full_rows)
    drawn = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    written = geometry.picture(drawn)
    assert written.shape == (900, 1600, 3)
    assert (written[:cut_full_rows] == written[cut_full_rows]).all()


@pytest.mark.parametrize("size", [(224, 400), (424, 800)])
@pytest.mark.parametrize(("u", "v"), [(801.0, 450.5), (60.25, 140.0), (1530.0, 850.75)])
def test_picture_and_calibration_agree_at_both_sizes(size: tuple[int, int], u: float, v: float) -> None:
    """A blob that is drawn where the small camera sees a point is where the full camera sees it."""
    camera = brief_scene().cameras[0]
    ray = np.linalg.inv(camera.intrinsic) @ [u, v, 1.0]
    small = ImageGeometry(*size, "model").camera(camera.resized(448, 256)).intrinsic @ ray
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    blob = np.exp(-((columns - small[0]) ** 2 + (rows - small[1]) ** 2) / 8)
    large = ImageGeometry(*size, "1600x900").picture(np.asarray(255 * blob, np.uint8)[..., None].repeat(3, -1))
    left, top = round(u) - 40, round(v) - 40
    mass = large[top : top + 80, left : left + 80, 0].astype(float)
    seen = [(mass * (np.arange(80) + 0.5 + left)).sum(), (mass * (np.arange(80) + 0.5 + top)[:, None]).sum()]
    np.testing.assert_allclose(np.array(seen) / mass.sum(), [u, v], atol=0.2)


@pytest.mark.parametrize(("height", "width"), [(225, 400), (0, 400), (232, 400), (224, 401)])
def test_sizes_that_the_network_does_not_have(height: int, width: int) -> None:
    with pytest.raises(InputError, match=f"{height}x{width}"):
        ImageGeometry(height, width)


def test_words_are_the_pieces_of_the_vocabulary_and_an_end(weights: Path) -> None:
    import sentencepiece

    folder = require_folder_of(TEXT_ENCODER, weights)
    pieces = sentencepiece.SentencePieceProcessor(model_file=str(folder / "spiece.model"))
    short, long = "Straight road", "A driving scene image at boston-seaport. " * 3
    encoder = T5TextEncoder(folder, CPU, 12)
    ids = encoder._tokenizer(short)["input_ids"]
    assert ids == [*pieces.encode(short), pieces.eos_id()]
    states = encoder.encode(short)
    assert states.hidden.shape == (12, CONFIG.caption_channels) and states.mask.tolist() == [True] * len(ids) + [
        False
    ] * (12 - len(ids))
    assert bool(encoder.encode(long).mask.all())
    assert torch.equal(states.hidden, T5TextEncoder(folder, CPU, 12).encode(short).hidden)


def test_the_decoder_of_a_text_encoder_is_not_needed(weights: Path, tmp_path: Path) -> None:
    folder = tmp_path / "t5"
    shutil.copytree(require_folder_of(TEXT_ENCODER, weights), folder)
    state = torch.load(folder / "pytorch_model.bin", weights_only=True)
    kept = {name: tensor for name, tensor in state.items() if not name.startswith(("decoder", "lm_head"))}
    torch.save(kept, folder / "pytorch_model.bin")
    words = "Straight road"
    expected = T5TextEncoder(require_folder_of(TEXT_ENCODER, weights), CPU, 12).encode(words)
    assert torch.equal(T5TextEncoder(folder, CPU, 12).encode(words).hidden, expected.hidden)
    torch.save({name: kept[name] for name in list(kept)[:2]}, folder / "pytorch_model.bin")
    with pytest.raises(InputError, match=r"lack \d+ tensors of T5EncoderModel"):
        T5TextEncoder(folder, CPU, 12)
    (folder / "pytorch_model.bin").write_bytes(b"nothing")
    with pytest.raises(InputError, match="does not hold a T5EncoderModel"):
        T5TextEncoder(folder, CPU, 12)


@pytest.mark.parametrize(("latent_frames", "frames"), [(1, 1), (2, 8), (3, 9), (4, 16)])
def test_views_are_decoded_to_bytes(weights: Path, latent_frames: int, frames: int) -> None:
    decoder = VideoDecoder.load(require_folder_of(AUTOENCODER, weights) / "vae", CPU, torch.float32)
    latent = torch.randn(16, latent_frames, 2, 3, generator=torch.Generator().manual_seed(3))
    video = decoder.frames(latent)
    assert video.shape == (frames, 16, 24, 3) and video.dtype == torch.uint8
    assert video.float().std() > 10
    with pytest.raises(InputError, match="cogvideox-vae"):
        decoder.frames(latent * torch.nan)


def test_every_frame_has_its_pictures(drawn: list[Images]) -> None:
    assert len(drawn) == 7
    for images in drawn:
        assert sorted(images) == sorted(camera.name for camera in brief_scene().cameras)
        assert {picture.shape for picture in images.values()} == {(*SIZE, 3)}
        assert len({picture.tobytes() for picture in images.values()}) == 6
    assert drawn[0]["CAM_FRONT"].std() > 10


def test_some_frames_are_those_of_the_whole_video(weights: Path, drawn: list[Images], tmp_path: Path) -> None:
    chosen = [0, 3, 6]
    found = list(small_renderer(weights, tmp_path).render(brief_scene(), chosen))
    assert_same_pictures(found, [drawn[frame] for frame in chosen])
    assert list(small_renderer(weights, tmp_path).render(brief_scene(), [])) == []
    with pytest.raises(InputError, match="frames 0 to 6, so frame 7 cannot be rendered"):
        list(small_renderer(weights, tmp_path).render(brief_scene(), [7]))


def test_seed_and_look_change_the_pictures(weights: Path, drawn: list[Images], tmp_path: Path) -> None:
    versions = {small_renderer(weights, tmp_path).version}
    for changes in ({"seed": 1}, {"look": PromptLook.NIGHT}, {"steps": 1}):
        changed = small_renderer(weights, tmp_path, **changes)
        versions.add(changed.version)
        found = next(changed.render(brief_scene(), [3]))
        assert (found["CAM_FRONT"] != drawn[3]["CAM_FRONT"]).any()
    assert len(versions) == 4


class Killed(Exception):
    """Stands for a process that ends."""


@pytest.mark.parametrize("at", ["sampling", "decoding"])
def test_a_killed_command_goes_on_to_the_same_pictures(
    weights: Path, drawn: list[Images], tmp_path: Path, at: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(renderer_module, "_KEEP_EVERY_STEPS", 1)
    save, decode, saved = SamplingState.save, VideoDecoder.frames, []

    def save_and_die(state: SamplingState, path: Path, key: str) -> None:
        save(state, path, key)
        saved.append(state.step)
        if at == "sampling" and len(saved) == 1:
            raise Killed

    def die_at_the_third(decoder: VideoDecoder, latent: torch.Tensor) -> torch.Tensor:
        decoded.append(1)
        if at == "decoding" and len(decoded) == 3:
            raise Killed
        return decode(decoder, latent)

    decoded: list[int] = []
    monkeypatch.setattr(SamplingState, "save", save_and_die)
    monkeypatch.setattr(VideoDecoder, "frames", die_at_the_third)
    with pytest.raises(Killed):
        list(small_renderer(weights, tmp_path).render(brief_scene(), range(7)))
    assert_same_pictures(list(small_renderer(weights, tmp_path).render(brief_scene(), range(7))), drawn)
    # Nothing was done twice but for the view in which it died.
    assert saved == [1, 2]
    assert len(decoded) == {"sampling": 6, "decoding": 7}[at]
    kept = sorted(path.name for path in tmp_path.rglob("*.safetensors"))
    assert len(kept) == 2 and "latent.safetensors" in kept


def test_another_output_size_needs_no_new_sampling(
    weights: Path, drawn: list[Images], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    list(small_renderer(weights, tmp_path).render(brief_scene(), [0]))
    monkeypatch.setattr(renderer_module, "load_published_network", None)
    large = small_renderer(weights, tmp_path, output="1600x900")
    found = next(large.render(brief_scene(), [0]))
    assert found["CAM_BACK"].shape == (900, 1600, 3)
    np.testing.assert_array_equal(found["CAM_BACK"], large.settings.geometry.picture(drawn[0]["CAM_BACK"]))


def test_what_is_kept_and_damaged_is_made_again(weights: Path, drawn: list[Images], tmp_path: Path) -> None:
    list(small_renderer(weights, tmp_path).render(brief_scene(), [0]))
    for path in tmp_path.rglob("*.safetensors"):
        path.write_bytes(path.read_bytes()[:-5] + b"wrong")
    assert_same_pictures(list(small_renderer(weights, tmp_path).render(brief_scene(), [0])), drawn[:1])


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.bfloat16])
def test_kept_tensors_are_what_they_were_or_nothing(tmp_path: Path, dtype: torch.dtype) -> None:
    path, tensor = tmp_path / "kept" / "tensor.safetensors", torch.arange(12).reshape(3, 4).to(dtype)
    cache_tensor(path, "key", tensor.T, {"words": 3})
    found = read_cached_tensor(path, "key")
    assert found is not None and torch.equal(found[0], tensor.T) and found[1] == {"words": 3}
    assert read_cached_tensor(path, "other") is None and read_cached_tensor(tmp_path / "absent", "key") is None
    data = path.read_bytes()
    for damaged in (b"", data[:-1], data[:40], data[:-1] + bytes([data[-1] ^ 1])):
        path.write_bytes(damaged)
        assert read_cached_tensor(path, "key") is None


def test_six_cameras_are_drawn_whatever_else_there_is(weights: Path, tmp_path: Path) -> None:
    scene, renderer = brief_scene(), small_renderer(weights, tmp_path)
    names = [camera.name for camera in scene.cameras]
    more = replace(scene, cameras=(replace(scene.cameras[0], name="CAM_ROOF"), *scene.cameras))
    assert [camera.name for camera in renderer.cameras(more)] == names
    with pytest.raises(InputError, match="has no camera CAM_FRONT_LEFT"):
        renderer.cameras(replace(scene, cameras=()))
    with pytest.raises(InputError, match="has no camera CAM_FRONT_LEFT"):
        renderer.estimate(replace(scene, cameras=()))


def test_scenes_longer_than_the_model_knows(weights: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="242 frames; MagicDriveDiT draws at most 241"):
        next(small_renderer(weights, tmp_path).render(busy_scene(242 / 12), [0]))


def test_missing_weights_are_a_sentence(tmp_path: Path, weights: Path) -> None:
    with pytest.raises(InputError) as caught:
        build_magicdrive_renderer(tmp_path, tmp_path / "nowhere")
    said = str(caught.value)
    for word in ("ema.pt", "8150 MB", TRANSFORMER.address, "weights fetch magicdrive-dit"):
        assert word in said
    with pytest.raises(InputError, match="made for estimates"):
        renderer = build_magicdrive_renderer(tmp_path, tmp_path / "nowhere", device="cpu", estimates_only=True)
        next(renderer.render(brief_scene(), [0]))
    whole, lacking = NetworkFiles.find(weights), tmp_path / "lacking"
    shutil.copytree(weights, lacking)
    assert NetworkFiles.find(lacking).fingerprint == whole.fingerprint
    (lacking / "CogVideoX-2b" / "vae" / "config.json").unlink()
    with pytest.raises(InputError, match=r"lacks vae/config\.json"):
        NetworkFiles.find(lacking)


@pytest.mark.parametrize(("size", "transformer", "decoder"), [((224, 400), 36.5, 2.4), ((424, 800), 139.0, 9.1)])
def test_the_estimate_is_that_of_the_specification(
    tmp_path: Path, size: tuple[int, int], transformer: float, decoder: float
) -> None:
    renderer = MagicDriveRenderer(
        RenderSettings(ImageGeometry(*size), device="cuda", tera_operations=400.0), None, tmp_path
    )
    found = renderer.estimate(busy_scene(20.0))
    words, network, pictures = found.stages
    # Keys and values are projected once, which saves a tenth of the published count.
    assert 0.85 * transformer < network.operations / 1e15 < 1.02 * transformer
    assert pictures.operations / 1e15 == pytest.approx(decoder, rel=0.03)
    assert words.operations / 1e15 == pytest.approx(0.003, rel=0.1)
    assert max(stage.gib for stage in found.stages) < 80
    assert found.seconds == pytest.approx(sum(stage.operations for stage in found.stages) / 4e14)
    assert "at 400 TFLOP/s (as given)" in found.plain()
    assert renderer.scene_seconds(busy_scene(20.0)) == found.seconds


def test_the_speed_is_measured_where_it_is_not_given(tmp_path: Path) -> None:
    renderer = MagicDriveRenderer(RenderSettings(ImageGeometry(*SIZE), device="cpu"), None, tmp_path, CONFIG)
    found = renderer.estimate(brief_scene())
    assert found.measured and found.tera_operations > 0
    assert "measured on one of its layers" in found.plain()
    assert MagicDriveConfig.full().hidden == 1152


def with_gpus(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: count > 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: count)


def test_workers_share_the_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, count, expected in (
        ("cuda", 2, ["cuda:0", "cuda:1", "cuda:0"]),
        ("auto", 3, ["cuda:0", "cuda:1", "cuda:2"]),
        ("cuda:1", 2, ["cuda:1", "cuda:1"]),
        ("auto", 0, ["cpu", "cpu"]),
        ("cpu", 4, ["cpu", "cpu"]),
    ):
        with_gpus(monkeypatch, count)
        assert [str(select_worker_device(name, number)) for number in range(len(expected))] == expected


def test_one_scene_is_drawn_on_each_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    cases: tuple[tuple[Executor, str, int, Executor], ...] = (
        (LocalProcesses(16), "auto", 4, LocalProcesses(4)),
        (LocalProcesses(2), "cuda", 4, LocalProcesses(2)),
        (LocalProcesses(16), "cuda:1", 4, LocalProcesses(1)),
        (LocalProcesses(16), "auto", 0, LocalProcesses(16)),
        (LocalProcesses(16), "cpu", 4, LocalProcesses(16)),
        (RayCluster("auto"), "cuda", 0, RayCluster("auto", gpus=1)),
        (RayCluster("auto"), "auto", 0, RayCluster("auto")),
    )
    for place, device, count, expected in cases:
        with_gpus(monkeypatch, count)
        assert build_rendering_executor(place, device) == expected
    with_gpus(monkeypatch, 0)
    with pytest.raises(InputError, match="no GPU found for device 'cuda'"):
        build_rendering_executor(LocalProcesses(2), "cuda")


def test_too_little_memory_is_a_sentence(weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise torch.cuda.OutOfMemoryError("too much")

    monkeypatch.setattr(renderer_module, "sample_latents", full)
    with pytest.raises(InputError, match="does not fit into the memory of cpu"):
        next(small_renderer(weights, tmp_path).render(brief_scene(), [0]))


def test_the_command_writes_the_camera_s_size_unless_told_otherwise(tmp_path: Path) -> None:
    made = build_magicdrive_renderer(tmp_path, None, device="cpu", estimates_only=True)
    assert {(camera.width, camera.height) for camera in made.cameras(brief_scene())} == {(1600, 900)}
    own = build_magicdrive_renderer(tmp_path, None, device="cpu", written_size="model", estimates_only=True)
    assert {(camera.width, camera.height) for camera in own.cameras(brief_scene())} == {(400, 224)}


@pytest.mark.parametrize(
    ("recorded", "written"),
    [(7, 7), (186, 186), (187, 185), (229, 225), (233, 233), (235, 233), (240, 240), (241, 241), (361, 241)],
)
def test_recordings_are_cut_to_the_published_lengths(recorded: int, written: int) -> None:
    assert compute_published_length(recorded) == written


def test_what_is_written_ends_where_the_published_clips_do(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 20 frames as long as whole recordings, 17 are drawn, and their keyframes are the samples."""
    monkeypatch.setattr(clip_module, "SHORTEST_WHOLE", 20)
    renderer, scene = small_renderer(weights, tmp_path / "work", steps=1), busy_scene(20 / 12)
    assert renderer.estimate(scene).frames == 17
    plan = DataSetPlan(tmp_path / "root", "val-r", renderer=renderer)
    key = write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={})
    finish_data_set(plan, [key])
    read = NuScenesData.open(tmp_path / "root").scene(scene.name)
    assert read.keyframes.tolist() == [0, 6, 12]
    sweeps = list((tmp_path / "root").glob("s*s/CAM_FRONT/*.jpg"))
    assert len(sweeps) == 17
