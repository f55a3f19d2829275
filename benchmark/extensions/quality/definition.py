"""Definition of the measurement in full: one object, stored in every record; two definitions never share a table.

The paper names the metrics (VBench's subject consistency, imaging quality), the text prompt and the rule that a mask
must overlap a projected vehicle; the rest is decided here.
"""

from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, get_args

from benchmark.constants import FOUR_WHEELED_CATEGORIES
from benchmark.errors import InputError, did_you_mean
from benchmark.weights.catalogue import DINO, GROUNDING_DINO, MUSIQ, SAM2, PublishedWeights

MaskSource = Literal["grounded-sam2", "sam2-boxes", "boxes"]
MASK_SOURCES: Final[tuple[MaskSource, ...]] = get_args(MaskSource)
Frames = Literal["keyframes", "all"]
Files = Literal["own", "lossless"]


@dataclass(frozen=True, slots=True)
class QualityDefinition:
    """Every choice that changes a number.

    Attributes:
        masks: Where masks come from. ``grounded-sam2`` is the paper's: Grounding DINO finds, SAM 2 segments and tracks;
            ``sam2-boxes``: SAM 2 is prompted with projected boxes; ``boxes``: the projected boxes themselves.
        frames: ``keyframes`` (2 Hz, annotated) or ``all`` (12 Hz, boxes between keyframes interpolated).
        files: ``own``: the images that the tables name; ``lossless``: the PNG files of the same names beside them.
        longer_side_px: Larger frames are brought down to this longer side by averaging areas, smaller ones are left as
            they are; everything below is in pixels of the result.
        categories: nuScenes categories that are subjects.
        prompt: Text for the detector.
        box_threshold: Detections below this score are dropped.
        text_threshold: Detections whose words score below this are dropped.
        detect_every: The detector looks at each so-many-th frame; SAM 2 tracks in between.
        min_overlap: A mask is kept and tied to an instance if their intersection over union is at least this; the
            instance is the one with the largest. A box is the visible part of the projected one.
        min_mask_px: Smaller masks are no appearance.
        min_visible: Source ``boxes`` only: share of a projected box in the image that nearer boxes must leave.
        near_m: Boxes are cut off so far in front of the camera.
        crop_px: Side of the square that a subject is brought to for DINO, bilinear without smoothing as in VBench.
        imaging_longer_px: Larger pictures are brought down to this longer side before MUSIQ, as VBench does.
        batch: Pictures that go through a network together; another number changes the last digits.
    """

    masks: MaskSource = "grounded-sam2"
    frames: Frames = "keyframes"
    files: Files = "own"
    longer_side_px: int = 800
    categories: tuple[str, ...] = FOUR_WHEELED_CATEGORIES
    prompt: str = "car."
    box_threshold: float = 0.35
    text_threshold: float = 0.25
    detect_every: int = 1
    min_overlap: float = 0.25
    min_mask_px: int = 1024
    min_visible: float = 0.5
    near_m: float = 0.5
    crop_px: int = 224
    imaging_longer_px: int = 512
    batch: int = 16

    def __post_init__(self) -> None:
        find_mask_source(self.masks)
        for name in ("longer_side_px", "detect_every", "min_mask_px", "crop_px", "imaging_longer_px", "batch"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} of the definition must be at least 1, got {getattr(self, name)}")

    def as_json(self) -> dict[str, Any]:
        """Plain values, as records hold them."""
        return {**asdict(self), "categories": list(self.categories)}


def find_mask_source(name: str) -> MaskSource:
    """A source of masks by name; raises `InputError` if there is none."""
    known_source = next((source for source in MASK_SOURCES if source == name), None)
    if known_source is None:
        raise InputError(
            f"unknown source of masks {name!r}; {did_you_mean(name, MASK_SOURCES)}use one of {', '.join(MASK_SOURCES)}"
        )
    return known_source


def list_required_weights(masks: MaskSource) -> tuple[PublishedWeights, ...]:
    """Weights that a source of masks and the two metrics need, in the order of use."""
    of_masks: dict[MaskSource, tuple[PublishedWeights, ...]] = {
        "grounded-sam2": (GROUNDING_DINO, SAM2),
        "sam2-boxes": (SAM2,),
        "boxes": (),
    }
    return (*of_masks[masks], DINO, MUSIQ)
