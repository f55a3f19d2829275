"""The rules of a challenge: a small file, ``rules.toml``, every line of which may be left out.

The defaults are the rules of the WACV 2026 challenge of adversarial driving scenes (one background vehicle changed, no
contact of background vehicles, on the drivable area, feasible motion) and that the recorded ego passes. It gives no
limits of motion and road: the defaults are what cars can do, and a wheel or two beside the mapped road. `RULE_SETS` has
a stricter set, which this project's own search keeps, and one without these limits, which are not the paper's.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from benchmark.machine.storage import content_key
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.text_files import parse_toml, read_toml

SCHEMA: Final = 1
RULES_FILE: Final = "rules.toml"
FOUR_WHEELED: Final = (
    "vehicle.car",
    "vehicle.truck",
    "vehicle.bus.rigid",
    "vehicle.bus.bendy",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
)


def _rule(default: Any, says: str, least: float | None = None) -> Any:
    return Field(default=default, description=says, ge=least)


class SceneRules(Stored):
    """Which scenes an entry has."""

    required: tuple[str, ...] = _rule((), "recordings that an entry must cover with a scene; empty: any")
    most_of_one: int = _rule(0, "most scenes made from one recording; 0: any number", 0)
    apart_m: float = _rule(0.1, "two scenes of one recording are duplicates if no changed vehicle differs by more", 0.0)


class ChangedVehicleRules(Stored):
    """Vehicles that may differ from the recording, and how."""

    least: int = _rule(1, "vehicles of a scene that must differ from the recording", 0)
    most: int = _rule(1, "vehicles of a scene that may differ from the recording", 0)
    categories: tuple[str, ...] = _rule(FOUR_WHEELED, "permitted categories of changed vehicles")
    start_m: float = _rule(0.0, "largest distance from its recorded position at its first keyframe", 0.0)
    to_the_end: bool = _rule(True, "whether it must be present at every keyframe from its first one on")

    @model_validator(mode="after")
    def _some_are_allowed(self) -> Self:
        if self.most < self.least:
            raise ValueError(f"at least {self.least} and at most {self.most} vehicles cannot be")
        return self


class UnchangedRules(Stored):
    """How much anything else may differ from the recording: nothing, unless an entry's software rounds."""

    position_m: float = _rule(0.0, "positions and sizes of everything else, poses of the ego, mounts of sensors", 0.0)
    rotation: float = _rule(0.0, "components of quaternions", 0.0)
    map_m2: float = _rule(1e-6, "area by which a surface of the map near the ego may differ", 0.0)
    points: bool = _rule(True, "whether counts of points, visibility and attributes are compared too")
    motion: float = _rule(1e-9, "speeds, accelerations and yaw rates given to planners (CAN bus)", 0.0)


class ImageRules(Stored):
    """Images at keyframes."""

    required: bool = _rule(True, "whether images are required if the recording has cameras")
    width: int = _rule(0, "pixels; 0: any, one for each camera", 0)
    height: int = _rule(0, "pixels; 0: any, one for each camera", 0)
    least_contrast: float = _rule(4.0, "least standard deviation of the grey values (0..255) of a picture", 0.0)
    of_their_time: bool = _rule(True, "whether pictures are checked for showing another keyframe or camera")


class MotionRules(Stored):
    """Limits of a changed vehicle's motion: what cars can do on dry asphalt."""

    acceleration_m_s2: float = _rule(4.5, "forwards", 0.0)
    braking_m_s2: float = _rule(8.0, "forwards, slower", 0.0)
    lateral_m_s2: float = _rule(7.0, "across, from speed and yaw rate", 0.0)
    yaw_rate_rad_s: float = _rule(1.4, "turning", 0.0)
    sideways_m_s: float = _rule(0.3, "of the rear axle across its heading", 0.0)
    backwards_m_s: float = _rule(0.3, "against its heading", 0.0)
    tolerance: float = _rule(1.05, "factor on all of them: finite differences overshoot", 1.0)
    launch_m_s2: float = _rule(10.0, "change of velocity where the recorded track ends (annotations are noisy)", 0.0)
    launch_m: float = _rule(0.2, "largest offset there", 0.0)


class RoadRules(Stored):
    """The drivable area of the recording's map, every 12th of a second where the vehicle differs."""

    centre_off_share: float = _rule(0.25, "largest share of the time with its centre off the road", 0.0)
    centre_off_m: float = _rule(1.0, "largest distance of its centre from the road", 0.0)
    corner_off_share: float = _rule(0.75, "largest share of the time with a corner off the road", 0.0)
    corner_off_m: float = _rule(1.5, "largest distance of a corner from the road", 0.0)


class GapRules(Stored):
    """Contact, every 12th of a second where the vehicle differs."""

    others_m: float = _rule(0.0, "least distance to other road users; 0: no contact", 0.0)
    ego_m: float = _rule(0.0, "least distance to the recorded ego; 0: it passes without contact", 0.0)
    rounded_m: float = _rule(0.002, "overlap of boxes that counts as rounding", 0.0)


class ChallengeRules(Stored):
    """The rules of a challenge, in the sections of ``rules.toml``."""

    schema_version: Literal[1] = Field(default=SCHEMA, alias="schema")
    name: str = _rule("challenge", "of the challenge, for reports")
    scenes: SceneRules = Field(default_factory=SceneRules)
    changed: ChangedVehicleRules = Field(default_factory=ChangedVehicleRules)
    unchanged: UnchangedRules = Field(default_factory=UnchangedRules)
    images: ImageRules = Field(default_factory=ImageRules)
    motion: MotionRules = Field(default_factory=MotionRules)
    road: RoadRules = Field(default_factory=RoadRules)
    gaps: GapRules = Field(default_factory=GapRules)

    @property
    def fingerprint(self) -> str:
        """Hash of all rules without their name: verdicts are comparable where it is equal."""
        return content_key("rules", self.model_dump(mode="json", exclude={"name"}))


_ANY: Final = 1e6
RULE_SETS: Final[dict[str, ChallengeRules]] = {
    "default": ChallengeRules(),
    # Limits of `benchmark.dynamics.bicycle.DriverLimits` and of `generation.search.verify`: a hurried driver.
    "strict": ChallengeRules(
        name="strict",
        motion=MotionRules(acceleration_m_s2=2.5, braking_m_s2=5.0, lateral_m_s2=4.0, yaw_rate_rad_s=0.9),
        road=RoadRules(centre_off_share=0.02, corner_off_share=0.15, corner_off_m=1.0),
    ),
    # The paper has no such limit among its reasons to drop scenes, nor do its presets (`generate --preset`).
    "paper": ChallengeRules(
        name="paper",
        motion=MotionRules(
            acceleration_m_s2=_ANY,
            braking_m_s2=_ANY,
            lateral_m_s2=_ANY,
            yaw_rate_rad_s=_ANY,
            sideways_m_s=_ANY,
            backwards_m_s=_ANY,
        ),
        road=RoadRules(centre_off_share=1.0, centre_off_m=_ANY, corner_off_share=1.0, corner_off_m=_ANY),
    ),
}
"""Rules to start from, by name."""


def read_rules(path: Path | None) -> ChallengeRules:
    """Read the rules of a challenge.

    Args:
        path: A ``rules.toml``; ``None`` for the defaults. What it leaves out has its default.

    Returns:
        The rules.

    Raises:
        InputError: If the file cannot be read, is not TOML, or has a rule that there is not or a value that cannot be.
    """
    if path is None:
        return ChallengeRules()
    return validate_stored(
        ChallengeRules.model_validate,
        read_toml(path),
        lambda where, why: f"{path}: {where or 'the rules'}: {why}; see docs/extensions/challenge.md for the rules",
    )


def format_rules(rules: ChallengeRules) -> str:
    """Rules as a TOML file that `read_rules` reads, each with its explanation."""
    return "\n".join(_lines(rules)) + "\n"


def _lines(rules: ChallengeRules) -> Iterator[str]:
    yield f"schema = {rules.schema_version}"
    yield _line("name", rules.name, ChallengeRules.model_fields["name"].description)
    for name in ChallengeRules.model_fields:
        table = getattr(rules, name)
        if isinstance(table, Stored):
            yield f"\n[{name}]  # {(type(table).__doc__ or '').splitlines()[0]}"
            for field, described in type(table).model_fields.items():
                yield _line(field, getattr(table, field), described.description)


def _line(name: str, value: Any, says: str | None) -> str:
    return f"{name} = {_value(value)}  # {says}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        # A string of JSON is one of TOML; DEL alone must be written out.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def validate_rules(data: bytes, where: str) -> bytes:
    """Bytes of a file of rules, returned once they can be read; ``where`` names the file in messages."""
    validate_stored(
        ChallengeRules.model_validate,
        parse_toml(data, where),
        lambda place, why: (
            f"{where}: {place or 'the rules'}: {to_one_line(why, 120)}; see docs/extensions/challenge.md"
        ),
    )
    return data
