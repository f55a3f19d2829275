"""What is said of the scenes of a split together, as ``data stats`` gives it."""

from typing import Annotated

from pydantic import Field

from benchmark.records.judgement import DriverName, SceneJudgement, SplitRealism, Text
from benchmark.records.statistics import Quantiles
from benchmark.records.stored import Stored

Count = Annotated[int, Field(ge=0)]


class LadderRow(Stored):
    """One rung of the ladder: how many of the scenes one reference driver survives.

    Attributes:
        hit_adversary: Scenes in which it touches an adversary first.
        hit_from_behind: Scenes in which another runs into it: agents replay their tracks and do not brake for it.
        beyond_end: Scenes in which it leaves the recorded path.
    """

    driver: DriverName
    survives: Count
    of: Count
    hit_adversary: Count
    hit_from_behind: Count
    beyond_end: Count

    @property
    def share(self) -> float | None:
        """Share of scenes that it survives."""
        return self.survives / self.of if self.of else None


class SeverityRow(Stored):
    """Distribution of one number, named with its unit, over the encounters with an adversary that have it."""

    name: Text
    of: Count
    quantiles: Quantiles | None


class SplitJudgement(Stored):
    """Judgements of a split's scenes, by name, and their summary.

    Attributes:
        ladder_of_recordings: The same of the recordings that the scenes were made from; empty where they are not at
            hand. Agents replay their tracks there, too: what a driver does not survive there no adversary did.
        unsolvable: Scenes that could not have been avoided by any driver.
        severity: Of the recorded ego's encounters with adversaries; times to contact only of those without contact.
        contacts: Encounters in which the recorded ego touches an adversary.
    """

    scenes: dict[str, tuple[SceneJudgement, ...]]
    ladder: tuple[LadderRow, ...]
    ladder_of_recordings: tuple[LadderRow, ...] = ()
    unsolvable: tuple[Text, ...]
    severity: tuple[SeverityRow, ...]
    contacts: Count
    realism: SplitRealism
