"""Differences of the presets ``paper`` and ``reference`` from what they are named after, each with its reason.

Shown by ``generate --preset NAME --dry-run`` and in ``docs/reference/differences-from-paper.md``. What the paper
leaves open is no departure; `INTERPRETATIONS` says how it is read and what each reading kept where it was tried.
"""

from dataclasses import dataclass, fields
from typing import Final

from generation.search.hyperparameters import HyperParameters


@dataclass(frozen=True, slots=True)
class PresetDifference:
    """One departure: what the paper or the code says and where, what is done here instead, and why."""

    said: str
    replacement: str
    reason: str

    def sentence(self) -> str:
        """For people."""
        return f"{self.said}; here {self.replacement}, because {self.reason}"


@dataclass(frozen=True, slots=True)
class PaperInterpretation:
    """A point that the paper leaves open; ``why`` tells what other readings kept, or why none was tried."""

    open: str
    taken: str
    why: str

    def sentence(self) -> str:
        """For people."""
        return f"{self.open}: read as {self.taken} ({self.why})"


_MODEL: Final = PresetDifference(
    "the trajectory model is a transformer trained on nuPlan (section 3; the code's ig360_adv.ckpt)",
    "the packaged model samples, trained on other recordings",
    "the weights are not free to pass on; --denoiser FILE takes them",
)

_CLEAN: Final = PresetDifference(
    "a kept adversary is one that collides with nobody",
    "the recorded ego must also be clear of it in the eyes of the four native protocols (touches-under-...)",
    "a step at which it is not is masked: whatever a planner does there counts as clean",
)

PAPER: Final[tuple[PresetDifference, ...]] = (
    _MODEL,
    PresetDifference(
        "any background vehicle may be chosen (section 3, appendix Adv-nuSc)",
        "only four-wheeled ones are",
        "rear axle and wheelbase are taken as 0.3 and 0.6 of the length, which is a car's measure and no cycle's",
    ),
    PresetDifference(
        "the selected vehicle drives on from its motion (section 3)",
        "one that is recorded reversing starts from a stand",
        "the tracker follows headings and never reverses",
    ),
    _CLEAN,
    PresetDifference(
        "surviving scenes are ranked by their adversarial challenge score (appendix Adv-nuSc)",
        "they are ranked by how closely and how urgently the moving ego is pressed",
        "ACScore is normalised within a batch, so that those of two scenes cannot be compared",
    ),
    PresetDifference(
        "a random subset of the scenes is looked at by people (appendix Adv-nuSc)",
        "nobody has looked before data review is run on what was built",
        "a command cannot; rejected scenes are left out from then on (docs/extensions/review.md)",
    ),
    PresetDifference(
        "scenes are rendered by MagicDriveDiT (section 3)",
        "a schematic renderer draws unless --renderer magicdrive is given",
        "its weights are large and need a GPU",
    ),
)

REFERENCE: Final[tuple[PresetDifference, ...]] = (
    _MODEL,
    PresetDifference(
        "scores are single precision",
        "double precision",
        "every number here is; verify scoring counts the few verdicts that differ",
    ),
    PresetDifference(
        "one seeded stream of random numbers serves sampling, scores and the switch of the challenge",
        "each search has its own, asked once a planning frame for the switch",
        "a result must not depend on what else is computed",
    ),
    PresetDifference(
        "where every score is beyond about 103 the softmax underflows and the program ends",
        "the vehicle is dropped as scores-underflow",
        "one vehicle must not end a build",
    ),
    PresetDifference(
        "a candidate with NaN ends the program",
        "that candidate is never chosen",
        "one candidate must not end a build",
    ),
    PresetDifference(
        "a vehicle that is absent in the 16 frames before its launch is given positions of nothing",
        "it is not tried (no-frame-to-launch-at)",
        "there is no motion to go on from",
    ),
    PresetDifference(
        "objects that are absent in a frame are boxes without a size inside the ego",
        "they are left out",
        "whoever touches one touches the ego's box, so that no verdict changes",
    ),
    PresetDifference(
        "the road under a chosen vehicle is read from a raster around the ego at each frame",
        "from the polygons of the map",
        "they are what the raster is drawn from",
    ),
    PresetDifference(
        "which of the editable vehicles is edited is said by hand",
        "up to 10 are drawn by the seed, as the paper says",
        "a command has to choose",
    ),
    PresetDifference(
        "the functions' defaults are 20 rounds and temperature 0.1",
        "5 rounds and temperature 1",
        "the shipped script passes these",
    ),
    PresetDifference(
        "a scene is dropped if the adversary never comes within 15 m",
        "it is not",
        "the code's array is zero before the launch, so that its rule never fires",
    ),
    PresetDifference(
        "a bad scene is planned to its end and then dropped",
        "planning ends where the reason shows",
        "the result is the same",
    ),
    PresetDifference(
        "there is no order among scenes",
        "they are written in the order of our ranking",
        "--top and --per-scene need one; without them nothing is dropped for it",
    ),
)

INTERPRETATIONS: Final[tuple[PaperInterpretation, ...]] = (
    PaperInterpretation(
        "how long one of the 12 timesteps of H lasts (table of hyper-parameters)",
        "1/12 s, as the code: a plan is followed for a second",
        "kept 17 of 58, and noisy-log touches the adversary in 1.7 % of samples; with half a second 8 and 0.03 %",
    ),
    PaperInterpretation(
        "what counts after H; ACStepWeight has T elements, Dist has H (appendix, Trajectory Scoring)",
        "two more seconds count a little in all terms, as the code's tail of 8 s",
        "17 of 58 and 1.7 %; without them cars see too late what is in their way: 3 and 0.01 %",
    ),
    PaperInterpretation(
        "short and long edges of the collision test (appendix, Trajectory Scoring)",
        "boxes alone, which the three steps compute with bounds that hold",
        "17 of 58 and 1.7 %; by the words a car 3.5 m to the side collides: 20 and 0.56 %",
    ),
    PaperInterpretation(
        "how near a body may pass (appendix, Trajectory Scoring)",
        "25 cm and 0.15 s at its own speed, in place of the code's boxes grown by a fifth and ego of 3.5 m x 7 m",
        "17 of 58 and 1.7 %; without a margin plans end in contact: 3 and none",
    ),
    PaperInterpretation(
        "which background vehicles come close (appendix Adv-nuSc)",
        "those that move, within 20 m between the centres",
        "17 of 58 and 1.7 %; parked ones too: 9 of 70 and 0.78 %",
    ),
    PaperInterpretation(
        "how much noise t_trunc adds (Algorithm 1)",
        "5, 4, 3, 2, 1 of 100 steps, as the code",
        "5 move a trajectory by 0.2 m after 1 s and 4 m after 8 s; others were not tried with the readings above",
    ),
    PaperInterpretation(
        "when a vehicle takes over that is not there at frame 0 (Algorithm 1)",
        "at its first frame in the area around the ego",
        "17 of 58 and 1.7 %; within 25 m of the ego 12 of 56 and 2.1 %: the nearest to the algorithm's frame 0 stands",
    ),
    PaperInterpretation("the size of a batch (section 3)", "256, as the code", "others were not tried"),
    PaperInterpretation(
        "how near it must get not to be dropped (appendix Adv-nuSc)",
        "4 m between the bodies, as the default",
        "others were not tried",
    ),
    PaperInterpretation(
        "argmax(R) in Algorithm 1, the highest score in section 3, lower is better in the appendix",
        "the lowest score",
        "the terms are penalties",
    ),
    PaperInterpretation(
        "noise is added to the batch in Algorithm 1, to what was drawn of it in section 3",
        "to what was drawn",
        "the draw would have no effect otherwise",
    ),
    PaperInterpretation(
        "collisions with other vehicles (appendix) or with any object (section 3)",
        "with any object that is there",
        "a scene in which it touches a pedestrian has no safe way either",
    ),
    PaperInterpretation(
        "the loop from 0 to the number of rounds (Algorithm 1)",
        "5 rounds after the first batch",
        "the code's count",
    ),
    PaperInterpretation(
        "what is a point outside the bird's-eye view",
        "off the road; the view is 100 m wide, of the planning frame, in cells of 0.5 m",
        "there is no road to be seen there",
    ),
    PaperInterpretation(
        "which motion lies between waypoints",
        "a natural cubic spline at 12 Hz",
        "straight lines have corners that the tracker would follow",
    ),
    PaperInterpretation(
        "how long a vehicle drives that leaves the recording early, or comes late",
        "to the end of the scene; it is not chosen with less than a second left",
        "Algorithm 1 goes on to the end",
    ),
)
"""Measured on up to five vehicles of each of seven recordings, seeds 0 and 1, first batches from the stored samples."""


def list_differences(preset: str, hyper: HyperParameters) -> tuple[PresetDifference, ...]:
    """Departures of a search, changed settings too, from what its preset is named after; ``default`` has none."""
    match preset:
        case "paper":
            known, preset_hyper = PAPER, HyperParameters.paper()
        case "reference":
            known, preset_hyper = REFERENCE, HyperParameters.reference()
        case _:
            return ()
    changed = [
        PresetDifference(
            f"{setting.name} is {getattr(preset_hyper, setting.name)}",
            f"it is {getattr(hyper, setting.name)}",
            "it was asked for",
        )
        for setting in fields(hyper)
        if getattr(hyper, setting.name) != getattr(preset_hyper, setting.name)
    ]
    return (*changed, *known)


def format_differences(preset: str, hyper: HyperParameters) -> list[str]:
    """Lines for ``--dry-run``: departures, then how the paper is read where it leaves something open."""
    differences = list_differences(preset, hyper)
    if not differences:
        return []
    lines = [
        f"preset {preset} departs from the {'text' if preset == 'paper' else 'code'} in {len(differences)} points:"
    ]
    lines += [f"- {point.sentence()}" for point in differences]
    if preset == "paper" and INTERPRETATIONS:
        lines += ["what the text leaves open:", *(f"- {point.sentence()}" for point in INTERPRETATIONS)]
    return lines
