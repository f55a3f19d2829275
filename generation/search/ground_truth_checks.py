"""Whether the recorded ego is clear of an adversary as the official protocols see both, and how large it is for them.

A protocol with a ground-truth check takes back every collision at a step at which the recorded ego collides by the same
rule. The rasters of UniAD and VAD see a vehicle 0.6 m to the left of the ego as touching it, and never turn the ego: an
adversary may be clear of the recorded ego and still be taken out of the evaluation just where it matters.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.datasets.sample_truth import truth_of_scene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import NATIVE_PROTOCOLS, masking_protocols, protocol
from benchmark.protocols.raster import RasterProtocol
from benchmark.protocols.stacked import stack
from benchmark.records.attempts import MaskedSteps
from benchmark.scene import Scene


def recorded_contacts(
    scene: Scene, instances: Collection[str], protocols: Iterable[str]
) -> dict[str, tuple[Bools, Bools]]:
    """Contacts that protocols find of the recorded ego: at the key frames of the data set, as they see it from each.

    Returns:
        For each protocol two times (K, 6) verdicts for K samples and the steps after them, False where the recording
        has ended: contact with one of these instances, and contact with anything else.
    """
    known = masking_protocols()
    truths = stack(truth_of_scene(scene, [""] * len(scene.keyframes)))
    own = np.array([name in instances for name in truths.instances], np.bool_)
    return {
        name: (known[name].recorded_contacts(truths, own), known[name].recorded_contacts(truths, ~own))
        for name in protocols
    }


def masked_steps(scene: Scene) -> dict[str, MaskedSteps]:
    """Steps of a scene that each protocol with a ground-truth check takes from every planner.

    They are counted by protocol: steps at which the recorded ego touches an adversary, and those at which it
    touches others alone.
    """
    return {
        name: MaskedSteps(adversary=int(own.sum()), others=int((others & ~own).sum()))
        for name, (own, others) in recorded_contacts(scene, scene.adversaries, masking_protocols()).items()
    }


def masked_together(scenes: Iterable[Mapping[str, MaskedSteps]]) -> dict[str, dict[str, int]]:
    """Masked steps of several scenes: by protocol those of ``adversary`` and of ``others``, as JSON values."""
    sums: dict[str, Counter[str]] = {}
    for by_protocol in scenes:
        for name, steps in by_protocol.items():
            sums.setdefault(name, Counter()).update(adversary=steps.adversary, others=steps.others)
    return {name: dict(found) for name, found in sums.items()}


def masked_line(sums: Mapping[str, Mapping[str, int]]) -> str:
    """`masked_together` for people."""
    told = ", ".join(f"{name} {of['adversary']} / {of['others']}" for name, of in sums.items())
    return f"steps masked whatever is planned, for adversaries / for others: {told}"


def raster_footprints(scene: Scene, frames: NDArray[np.int64]) -> Floats:
    """The recorded ego as the rasters of the native protocols show it, wherever key frames may lie.

    At a frame that a plan reaches at its k-th step the ego looks as it did k half seconds before. (S, 6, 5) boxes,
    one for each step of (S,) frames: what any of the rasters covers on average.
    """
    rasters = [known for known in map(protocol, NATIVE_PROTOCOLS) if isinstance(known, RasterProtocol)]
    ends = np.stack([raster.mean_ends_m for raster in rasters])
    rear, front, right, left = ends[:, 0].min(), ends[:, 1].max(), ends[:, 2].min(), ends[:, 3].max()
    pose = scene.ego.pose
    heading = pose[frames, 2, None]
    lidar = pose[frames, None, :2] + scene.lidar.translation[0] * _direction(heading)
    step = FRAMES_PER_KEYFRAME * np.arange(1, PLAN_STEPS + 1)
    yaw = pose[np.maximum(frames[:, None] - step, 0), 2]
    ahead, aside = _direction(yaw), _direction(yaw + np.pi / 2)
    center = lidar + 0.5 * ((rear + front) * ahead + (right + left) * aside)
    size = np.broadcast_to([front - rear, left - right], center.shape)
    return np.concatenate([center, size, yaw[..., None]], axis=-1)


def _direction(yaw_rad: Floats) -> Floats:
    return np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)
