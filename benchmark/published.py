"""What the paper prints of its data set and of its runtime; quoted, never counted or measured here."""

from typing import Final

PAPER: Final = "Challenger: Affordable Adversarial Driving Video Generation"

DATA_SET_SOURCE: Final = f'{PAPER}, appendix "The Adv-nuSc Dataset"'
ADV_NUSC: Final = {
    "instances": 12_858,
    "ego_poses": 254_436,
    "scenes": 156,
    "samples": 6_115,
    "sample_data": 254_436,
    "annotations": 225_085,
}
"""Rows of the tables of Adv-nuSc."""

RUNTIME_SOURCE: Final = f'{PAPER}, appendix "Runtime Analysis"'
RUNTIME_S: Final = {"sampling": 17.36, "physics": 211.36, "scoring": 194.72, "rendering": 395.18}
"""Seconds of each stage for one scene of about 240 frames and six cameras."""
RUNTIME_MACHINE: Final = (
    "two Intel Xeon Platinum 8457C, 512 GB of memory and four NVIDIA L20 of 48 GB, one of which samples trajectories "
    "while all render"
)
