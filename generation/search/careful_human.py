"""Whether a careful and competent human survives an executed track: the exact ladder, where candidates had a proxy."""

from benchmark.drivers.driving import Rung, Situation, drive
from benchmark.drivers.outcomes import Contact, Surroundings
from benchmark.drivers.reaction import Driver
from benchmark.encounters.tracks import Tracks
from benchmark.scene import Scene


def careful_human_contact(scene: Scene, agent: int) -> Contact | None:
    """What the careful human (``cc`` of ``docs/severity.md``) touches on the ego's path.

    Args:
        scene: The adversarial scene.
        agent: Index of the adversary.

    Returns:
        The first contact with anybody, or ``None``.
    """
    situation = Situation.of(Tracks.of_scene(scene), adversary=agent)
    (motion,) = drive(situation, [Rung(Driver.CC)])
    return Surroundings.of(situation).outcome(motion).contact
