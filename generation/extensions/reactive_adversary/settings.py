"""Settings of a reactive adversary: its budget, its knowledge of the ego, and the scores of its search."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Final

from benchmark.constants import FRAME_HZ
from benchmark.errors import InputError
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.hyperparameters import HyperParameters
from generation.search.presets import build_default_settings

VERSION: Final = 3
"""Raised whenever the same adversary would drive elsewhere in the same drive."""
AHEAD_WEIGHT: Final = 4.0
LONGEST_FRAMES: Final = 36
"""Most frames between two plans: the frames over which candidates are scored."""
OTHERS: Final = ("replay", "idm")


class EgoPrediction(StrEnum):
    """Knowledge of an adversary about the ego.

    ``PLAN``: that it drives its plan in force. ``MOTION``: that it keeps its speed on its route, or its turn where it
    has left that. ``MOTION_ONLY``: that it keeps its speed and its turn; no recorded route is known, neither is the
    track that a scene was made with. ``NOTHING``: that it stays where it is.
    ``RECORDING``: the recorded future, which only the recorded ego has; for tests, no command line offers it.
    """

    PLAN = "plan"
    MOTION = "motion"
    MOTION_ONLY = "motion-only"
    NOTHING = "nothing"
    RECORDING = "recording"


def build_reactive_settings() -> HyperParameters:
    """The default search of open loop, and that who falls behind the ego comes back ahead of it."""
    return replace(build_default_settings(), ahead_weight=AHEAD_WEIGHT)


@dataclass(frozen=True, slots=True)
class AdversarySettings:
    """Settings of an adversary in the loop, planned anew every `every_frames` of 1/12 s.

    `knows` is how it predicts the ego; nothing else depends on `keep_considered`.
    """

    knows: EgoPrediction = EgoPrediction.MOTION
    every_frames: int = FRAME_HZ
    others: str = "replay"
    hyper: HyperParameters = field(default_factory=build_reactive_settings)
    keep_considered: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.every_frames <= LONGEST_FRAMES:
            raise InputError(
                f"an adversary must be replanned every 1/{FRAME_HZ} to {LONGEST_FRAMES / FRAME_HZ:g} s, not every "
                f"{self.every_frames / FRAME_HZ:.3g} s (--adversary-every)"
            )
        if self.others not in OTHERS:
            raise InputError(f"other road users beside an adversary must be {' or '.join(OTHERS)}, not {self.others!r}")

    @classmethod
    def of(
        cls,
        *,
        knows: str = "motion",
        every_s: float = 1.0,
        others: str = "replay",
        rounds: int | None = None,
        candidates: int | None = None,
        keep_considered: bool = False,
    ) -> "AdversarySettings":
        """Settings by plain values, as of the command line; those of the search if ``None``.

        `every_s` seconds between plans are taken as whole frames of 1/12 s.
        """
        known = {
            prediction.value: prediction for prediction in EgoPrediction if prediction is not EgoPrediction.RECORDING
        }
        if knows not in known:
            raise InputError(f"--adversary-knows must be one of {', '.join(known)}, not {knows!r}")
        hyper = build_reactive_settings()
        hyper = replace(
            hyper,
            rounds=hyper.rounds if rounds is None else rounds,
            candidates=hyper.candidates if candidates is None else candidates,
        )
        frames = round(min(max(every_s, 0.0), 1e6) * FRAME_HZ) if every_s == every_s else 0
        return cls(known[knows], frames, others=others, hyper=hyper, keep_considered=keep_considered)

    def facts(self, prior_fingerprint: str) -> Mapping[str, Any]:
        """Facts on what is measured, in names: two tables whose adversaries differ in it never mix."""
        return {
            "policy": VERSION,
            "knows": self.knows.value,
            "every_s": round(self.every_frames / FRAME_HZ, 6),
            "others": self.others,
            "rounds": self.hyper.rounds,
            "candidates": self.hyper.candidates,
            "search": f"{ALGORITHM_VERSION}-{self.hyper.fingerprint[:12]}",
            "prior": prior_fingerprint[:12],
        }
