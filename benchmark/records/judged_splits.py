"""What is said of the scenes of a split together, as ``data stats`` gives it."""

from typing import Annotated

from pydantic import Field

from benchmark.records.judgement import DriverName, SceneJudgement, SplitRealism, Text
from benchmark.records.statistics import Quantiles
from benchmark.records.stored import Stored

Count = Annotated[int, Field(ge=0)]


class LadderRow(Stored):
    """One rung of the ladder.

    Attributes:
        driver: Who drives.
        survives: Scenes that it survives.
        of: Scenes.
        hit_adversary: Scenes in which it touches an adversary first.
        hit_from_behind: Scenes in which somebody runs into it: agents replay their tracks and do not brake for it.
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
    """The distribution of one number over encounters with an adversary.

    Attributes:
        name: Of the number, with its unit.
        of: Encounters that have it.
        quantiles: Its distribution; null where none has.
    """

    name: Text
    of: Count
    quantiles: Quantiles | None


class SplitJudgement(Stored):
    """A split.

    Attributes:
        scenes: Judgements of each scene, by name.
        ladder: Rungs in order.
        ladder_of_recordings: The same of the recordings that the scenes were made from; empty where they are not at
            hand. Agents replay their tracks there, too: what a driver does not survive there no adversary did.
        unsolvable: Scenes that nobody could have avoided.
        severity: Of the recorded ego's encounters with adversaries; times to contact only of those without contact.
        contacts: Encounters in which the recorded ego touches an adversary.
        realism: How real the adversaries move.
    """

    scenes: dict[str, tuple[SceneJudgement, ...]]
    ladder: tuple[LadderRow, ...]
    ladder_of_recordings: tuple[LadderRow, ...] = ()
    unsolvable: tuple[Text, ...]
    severity: tuple[SeverityRow, ...]
    contacts: Count
    realism: SplitRealism
